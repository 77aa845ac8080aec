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

static const char* take(Crumple* session, const char* path) {
  static char bytes[1 << 20];
  FILE* file = fopen(path, "rb");
  if (!file) {
    perror(path);
    exit(1);
  }
  const size_t size = fread(bytes, 1, sizeof bytes, file);
  fclose(file);
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

int main(void) {
  Crumple* session = begin();
  char line[4096];
  while (fgets(line, sizeof line, stdin)) {
    line[strcspn(line, "\n")] = 0;
    if (!*line) {
      crumple_close(session);
      session = begin();
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
    }
    puts("}");
  }
  crumple_close(session);
}
