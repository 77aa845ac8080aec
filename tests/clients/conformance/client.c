// Runs the conformance table with the C library. run.py specifies its input and output.
#include <crumple_client.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void must(int holds) {
  if (holds) return;
  fprintf(stderr, "%s\n", crumple_error());
  exit(1);
}

static Crumple* begin(void) {
  const CrumpleOptions options = {CRUMPLE_CLIENT_VERSION, 0, NULL, "main", NULL, NULL};
  Crumple* session = NULL;
  must(crumple_open(&options, &session) == CRUMPLE_OK);
  must(crumple_follow(session, "a", 0) == CRUMPLE_OK);
  return session;
}

static uint64_t held_tick(Crumple* session) {
  CrumpleSurface surface;
  return crumple_surface(session, "a", &surface) == CRUMPLE_OK ? surface.tick : 0;
}

static char bytes[1 << 20];

static size_t read_all(const char* path) {
  FILE* file = fopen(path, "rb");
  if (!file) {
    perror(path);
    exit(1);
  }
  const size_t size = fread(bytes, 1, sizeof bytes, file);
  fclose(file);
  return size;
}

static const char* take(Crumple* session, const char* path) {
  const size_t size = read_all(path);
  CrumpleStatistics before, now;
  crumple_statistics(session, &before);
  const uint64_t tick = held_tick(session);
  const char* key = strstr(path, ".keyframe") ? "crumple/1/main/car/a/key/0" : "crumple/1/main/car/a/delta/0";
  if (crumple_feed(session, key, bytes, size) != CRUMPLE_OK) return "refused";
  crumple_statistics(session, &now);
  if (now.older > before.older) return "old";
  if (now.asked > before.asked) return "missing keyframe";
  return held_tick(session) == tick ? "part" : "applied";
}

static int ends_in(const char* path, const char* ending) {
  return strlen(path) > strlen(ending) && !strcmp(path + strlen(path) - strlen(ending), ending);
}

// A mesh of the game's own, and the car that it is bound to.
static float own[1000][9];
static uint32_t own_count, mapping;
static char asset[17];

static void map_own(Crumple* session, const char* path) {
  const size_t size = read_all(path);
  memcpy(&own_count, bytes, 4);
  must(own_count <= sizeof own / sizeof own[0] && size == 4 + own_count * sizeof own[0]);
  memcpy(own, bytes + 4, size - 4);
  CrumpleOwnMesh mesh = {own[0], own[0] + 3, own[0] + 6, sizeof own[0], own_count, NULL, 0, 0};
  must(crumple_map(session, asset, &mesh, &mapping) == CRUMPLE_OK);
  printf("{\"outcome\": \"mapped\", \"vertices\": %" PRIu32 ", \"on_vertices\": %" PRIu32 ", \"farthest\": %.7g}\n", own_count,
         mesh.on_vertices, (double)mesh.farthest);
}

static void print_own(Crumple* session) {
  CrumpleVertices out = {own[0], NULL, own[0] + 3, sizeof own[0], own_count, 0, 0, 0, mapping, own[0] + 6};
  must(crumple_copy(session, "a", &out) == CRUMPLE_OK);
  printf(", \"own\": [");
  for (uint32_t i = 0; i < own_count; ++i)
    for (int k = 0; k < 9; ++k) printf("%s%.8g%s", k ? ", " : i ? ", [" : "[", (double)own[i][k], k == 8 ? "]" : "");
  CrumpleParts parts;
  must(crumple_parts(session, asset, &parts) == CRUMPLE_OK);
  printf("], \"poses\": [");
  for (uint32_t i = 0; i < parts.count; ++i) {
    CrumplePose pose;
    must(crumple_part_pose(session, "a", i, 0, &pose) == CRUMPLE_OK);
    printf("%s[%.8g, %.8g, %.8g, %.8g, %.8g, %.8g, %.8g]", i ? ", " : "", pose.position[0], pose.position[1], pose.position[2],
           (double)pose.orientation[0], (double)pose.orientation[1], (double)pose.orientation[2], (double)pose.orientation[3]);
  }
  printf("]");
}

int main(void) {
  Crumple* session = begin();
  char line[4096];
  while (fgets(line, sizeof line, stdin)) {
    line[strcspn(line, "\n")] = 0;
    if (!*line) {
      crumple_close(session);
      session = begin();
      own_count = 0;
      continue;
    }
    if (ends_in(line, ".car")) {
      must(crumple_add_asset(session, bytes, read_all(line), asset) == CRUMPLE_OK);
      puts("{\"outcome\": \"held\"}");
      continue;
    }
    if (ends_in(line, ".own")) {
      map_own(session, line);
      continue;
    }
    printf("{\"outcome\": \"%s\"", take(session, line));
    CrumpleSurface surface;
    if (crumple_surface(session, "a", &surface) == CRUMPLE_OK) {
      int64_t sum = 0, moment = 0;
      for (uint32_t k = 0; k < 3 * surface.node_count; ++k) {
        sum += surface.quanta[k];
        moment += (int64_t)k * surface.quanta[k];
      }
      printf(", \"tick\": %" PRIu64 ", \"hash\": \"%016" PRIx64 "\", \"nodes\": %" PRIu32 ", \"quantum_um\": %ld", surface.tick,
             surface.hash, surface.node_count, lround(1e6 * (double)surface.quantum));
      printf(", \"sum\": %" PRId64 ", \"moment\": %" PRId64, sum, moment);
      if (own_count) print_own(session);
    }
    puts("}");
  }
  crumple_close(session);
}
