// The door for hosts (games, simulators, scripts) and viewers: one session with one scene of a server, in plain C.
// Pull-based: nothing is ever called back. crumple_poll takes in what has arrived; everything else reads what it left.
// Strings and views that come out stay valid until the next crumple_poll or crumple_feed. One thread at a time uses a session.
// Units are SI, axes of the world are z up, of a car x forward, y left, z up; orientations are unit quaternions (x, y, z, w).
// Functions that return int give a CrumpleStatus; where it is negative, crumple_error() has the sentence. Any pointer may be
// NULL and a session closed: where a function needs it, that is CRUMPLE_BAD_ARGUMENT, or 0 where it counts, and nothing is
// done.
#pragma once

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

// Of all structs below; crumple_open refuses another.
#define CRUMPLE_CLIENT_VERSION 5u

enum CrumpleStatus {
  CRUMPLE_OK = 0,
  CRUMPLE_PENDING = 1,        // not there yet: poll and ask again
  CRUMPLE_BAD_ARGUMENT = -1,  // a value that the server would refuse, or a struct of another version
  CRUMPLE_CLOSED = -2,        // no connection
  CRUMPLE_DROPPED = -3,       // the session's own queue was full: not sent
  CRUMPLE_NO_ANSWER = -4,     // the server did not answer in time
  CRUMPLE_UNKNOWN = -5,       // no such car, ticket or asset
  CRUMPLE_NO_MEMORY = -6,     // there was none left
  CRUMPLE_FAILED = -7,        // something else broke down: crumple_error says what
};

// The sentence for the last error of this thread; valid until its next call.
const char* crumple_error(void);

typedef struct Crumple Crumple;

typedef struct CrumpleOptions {
  uint32_t version;     // CRUMPLE_CLIENT_VERSION
  uint32_t timeout_ms;  // for the connection and for each command; 0: 2000
  const char* connect;  // "tcp/127.0.0.1:7447"; "tls/HOST:7447" where the server has a certificate; NULL: see crumple_feed
  const char* scene;
  const char* host;     // the id under which this session moves cars; NULL: a viewer only
  const char* network;  // JSON5 of zenoh's own configuration, laid over ours: TLS, user, password; NULL or "": none
} CrumpleOptions;

// Waits until the server of the scene is seen, at most timeout_ms. The first session of a process sets RUST_MIN_STACK in the
// environment, if nobody has (32 MiB of address space a thread), and the first over TLS ZENOH_RUNTIME (zenoh breaks such a link
// otherwise): no other thread may read the environment meanwhile, and the first session over TLS must be the first of the
// process.
int crumple_open(const CrumpleOptions*, Crumple** out);
// Waits until what was sent has come to the other end, at most 1 s. A session that was closed stays closed: its handle never
// comes again, and to close it twice does nothing.
void crumple_close(Crumple*);

// Takes in what has arrived; waits for at most timeout_us if there is nothing. Returns the number of messages, or a negative
// Status.
int crumple_poll(Crumple*, uint64_t timeout_us);

typedef struct CrumpleStatistics {
  uint64_t received, received_bytes;  // all messages
  uint64_t surface, surface_bytes;    // keyframes and deltas among them
  uint64_t older, refused, asked;     // dropped as older than what is held; malformed; keyframes asked for
} CrumpleStatistics;
void crumple_statistics(const Crumple*, CrumpleStatistics* out);

// The server's time now, s, as in CrumpleReaction: what came soonest of the last second or two tells it, so it may be late by a
// message's way, and step a little. 0: nothing has come yet. Without a network: that of the newest tick.
double crumple_time(const Crumple*);

// A bad line, to test a game on: from now on the poses that this session sends, and all that is published to it, are late or
// lost, each message by itself, so that they overtake one another; poses leave with the next crumple_poll. The same seed draws
// alike. Commands, questions and their answers come as ever. All 0: the line is good again, once what is under way has come.
typedef struct CrumpleImpairment {
  float delay, jitter;  // s; one way, evenly between delay - jitter and delay + jitter; up to 60
  float loss, repeat;   // shares, 0 to 1: of what is lost, and of what comes twice
  uint32_t seed;
} CrumpleImpairment;
int crumple_impair(Crumple*, const CrumpleImpairment*);

// A session without `connect` has no network: it takes in what it is given here, for recordings, tests and other ways to carry
// messages. key: the message's, which is its topic in a recording. A message that the session does not follow is passed over;
// one that does not hold is CRUMPLE_BAD_ARGUMENT and changes nothing. A delta whose keyframe is not held counts as `asked` in
// CrumpleStatistics: to be given the keyframe.
int crumple_feed(Crumple*, const char* key, const void* bytes, size_t size);

// ---- commands: each gives a ticket; its answer comes by crumple_poll
// ---------------------------------------------------------

typedef struct CrumplePose {
  double position[3];
  float orientation[4];
} CrumplePose;

typedef struct CrumpleSpawn {
  CrumplePose pose;
  float mass;        // kg; 0: the baked car's
  float inertia[3];  // kg m^2 about the centre of mass, along the car's axes; all 0: the baked car's, in proportion to mass
  float center_of_mass[3];  // m; all 0: the baked car's
  int planar;               // 1: on its wheels, contacts slow it in x, y and yaw only
} CrumpleSpawn;

// crumple_keep() keeps everything; set what should change. Ranges: the server's server/sim/material.h.
typedef struct CrumpleParameters {
  int solver;                                                                      // 0 nodal, 1 classic; -1: keep
  uint32_t iterations, substeps;                                                   // 0: keep
  float tolerance;                                                                 // NaN: keep
  int region;                                                                      // which the fields below are for; -1: all
  float young_modulus, poisson_ratio, yield, hardening, plastic_limit, viscosity;  // NaN: keep
  float distance_stiffness, volume_stiffness, plasticity;                          // NaN: keep; of `classic`
} CrumpleParameters;
CrumpleParameters crumple_keep(void);

// asset: hash of the baked car, 16 hexadecimal digits.
int crumple_spawn(Crumple*, const char* car, const char* asset, const CrumpleSpawn*, uint64_t* ticket);
int crumple_despawn(Crumple*, const char* car, uint64_t* ticket);
// amount: share of the damage that is taken away, in [0, 1].
int crumple_repair(Crumple*, const char* car, float amount, uint64_t* ticket);
int crumple_set_parameters(Crumple*, const char* car, const CrumpleParameters*, uint64_t* ticket);
// The answer carries the state; crumple_load takes it back, for any car of the same asset.
int crumple_save(Crumple*, const char* car, uint64_t* ticket);
int crumple_load(Crumple*, const char* car, const void* state, size_t size, uint64_t* ticket);

typedef struct CrumpleAnswer {
  int ok;
  uint64_t tick;         // the first tick that knows of it
  const char* sentence;  // why not, where ok is 0
  const uint8_t* state;  // of crumple_save
  size_t state_size;
} CrumpleAnswer;
// CRUMPLE_OK: the answer is there (of the last 256 commands); CRUMPLE_PENDING; CRUMPLE_NO_ANSWER.
int crumple_answer(Crumple*, uint64_t ticket, CrumpleAnswer* out);
// Polls until the answer is there or the session's timeout has passed.
int crumple_wait(Crumple*, uint64_t ticket, CrumpleAnswer* out);

// ---- host
// --------------------------------------------------------------------------------------------------------------------

typedef struct CrumpleCarPose {
  const char* car;
  CrumplePose pose;           // where the host has the car now
  float velocity[3];          // of the centre of mass, m/s, world
  float angular_velocity[3];  // rad/s, world
  uint64_t seen;              // tick of the last reaction that pose and velocity contain; 0: the car follows a script
  float importance;           // in (0, 1]: how much it matters now, which chooses its level; 0: 1
} CrumpleCarPose;
// All cars of this host in one message; sequence numbers are the session's own. time: the host's clock, s.
int crumple_publish_poses(Crumple*, double time, const CrumpleCarPose*, size_t count);

enum CrumpleShape { CRUMPLE_BOX, CRUMPLE_SPHERE, CRUMPLE_CAPSULE, CRUMPLE_HALF_SPACE, CRUMPLE_HULL };

typedef struct CrumpleObstacle {
  uint32_t id;
  int shape;            // CrumpleShape
  float size[3];        // box: half extents; sphere: radius; capsule: radius, half the length of its axis (local z)
  const float* points;  // hull: 3 floats each
  size_t point_count;
  CrumplePose pose;
  float velocity[3], angular_velocity[3];  // it moves on with these
  float friction;                          // Coulomb
} CrumpleObstacle;
// The whole list of this host; replaces the one before.
int crumple_publish_obstacles(Crumple*, const CrumpleObstacle*, size_t count);

typedef struct CrumpleReaction {
  const char* car;
  uint64_t tick;
  double time;                           // of the server's ticks, s
  float impulse[3], angular_impulse[3];  // of the tick, N s and N m s about the centre of mass, world
  CrumplePose pose;                      // at the end of the tick
  float velocity[3], angular_velocity[3];
  double energy_absorbed, energy_stored;  // J since spawn
  float deepest;                          // m
  uint32_t contacts;
} CrumpleReaction;
// The next reactions not yet taken, oldest first; beyond 4096 waiting the oldest are dropped. Returns how many.
size_t crumple_take_reactions(Crumple*, CrumpleReaction* out, size_t capacity);

// ---- viewer
// ------------------------------------------------------------------------------------------------------------------

// From now on this car's surface is held; NULL: every car's, those present and those to come. level 0: told every tick, in the
// scene's quantum; 1: for who is far, told ten times a second, in eight times that. To be called again with the other one as
// often as that changes: what is held stays until the first keyframe of the new level, which in a crash may be up to a second
// older.
int crumple_follow(Crumple*, const char* car, int level);
// Ids of the cars that this session holds or follows. Returns how many there are.
size_t crumple_cars(const Crumple*, const char** ids, size_t capacity);

typedef struct CrumpleSurface {
  uint64_t tick;          // the newest one held whole
  uint64_t hash;          // XXH64 of the quantised displacements, as the server states it
  uint32_t node_count;    // of the skin: those that a vertex moves with
  float quantum;          // m; of the level that is held
  const char* asset;      // hash of the baked car
  const int16_t* quanta;  // 3 a node: displacement from rest in quanta, car's frame
  int dirty;              // no crumple_copy of this car has shown it yet
  int alive;              // 0: despawned, or its server is gone; without a network always 1
} CrumpleSurface;
// CRUMPLE_PENDING: followed, but nothing whole has arrived yet; or the session was not polled for half a second, and what is
// current has not arrived since: keep what was drawn.
int crumple_surface(Crumple*, const char* car, CrumpleSurface* out);

// Where crumple_copy writes, 3 floats a vertex in the car's frame: arrays of their own (stride 12), or members of one vertex
// (its size). NULL: not wanted.
typedef struct CrumpleVertices {
  float* position;      // m
  float* displacement;  // from rest, m
  float* normal;        // of length 1: of the triangles around the vertex, weighted by their area
  size_t stride;        // bytes from one vertex to the next
  size_t capacity;      // vertices that there is room for
  // 0 or less: the newest that is held. Otherwise what was at that time, s, of the last half second; between two ticks the way
  // from one to the other. crumple_time() - 0.1, the same for the poses, moves smoothly however unevenly messages come.
  double time;
  // Set by crumple_copy: outside of these `count` vertices nothing is other than after the last crumple_copy of this car.
  uint32_t first, count;
} CrumpleVertices;
// Needs the asset (crumple_mesh), and asks for it: CRUMPLE_PENDING until it has arrived.
int crumple_copy(Crumple*, const char* car, CrumpleVertices*);

// The undamaged car, from the server, once per asset.
typedef struct CrumpleMesh {
  uint32_t vertex_count, triangle_count;
  const float* vertex;       // 3 each, m, car's frame
  const uint32_t* triangle;  // 3 each
  float mass;                // kg
  float center_of_mass[3];   // m
  const char* name;
  const char* attribution;  // must be shown where the car is shown
} CrumpleMesh;
// CRUMPLE_PENDING until it has arrived. Views live as long as the session.
int crumple_mesh(Crumple*, const char* asset, CrumpleMesh* out);
// Takes a baked car that the caller has as a file, so that it need not come from the server. hash: its name for crumple_spawn.
int crumple_add_asset(Crumple*, const void* car, size_t size, char hash[17]);

typedef struct CrumpleHealth {
  uint64_t tick, late;      // late: ticks that could not start in time
  float rate;               // ticks a second
  float tick_ms, worst_ms;  // of the last second's ticks: mean and worst
  uint64_t refusals;        // all reasons together
} CrumpleHealth;
int crumple_health(const Crumple*, CrumpleHealth* out);

#ifdef __cplusplus
}
#endif
