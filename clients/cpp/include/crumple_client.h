// The client library in plain C, for hosts (games, simulators, scripts) and viewers. A session belongs to one scene of a
// server. The library never calls back. crumple_poll takes in the messages that have arrived; all other functions read what it
// took in. Strings and views that a function gives stay valid until the next crumple_poll or crumple_feed. Only one thread at a
// time may use a session. Units are SI. In the world z is up; a car has x forward, y left and z up; orientations are unit
// quaternions (x, y, z, w). Functions that return int return a CrumpleStatus; if it is negative, crumple_error() explains it.
// Any pointer may be NULL, and any session may be closed: a function that needs it does nothing and returns
// CRUMPLE_BAD_ARGUMENT, or 0 if the function counts something.
#pragma once

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

// The version of all structs below; crumple_open refuses any other.
#define CRUMPLE_CLIENT_VERSION 6u

enum CrumpleStatus {
  CRUMPLE_OK = 0,
  CRUMPLE_PENDING = 1,        // not there yet: poll and ask again
  CRUMPLE_BAD_ARGUMENT = -1,  // a value that the server would refuse, or a struct of another version
  CRUMPLE_CLOSED = -2,        // no connection
  CRUMPLE_DROPPED = -3,       // the session's own queue was full: not sent
  CRUMPLE_NO_ANSWER = -4,     // the server did not answer in time
  CRUMPLE_UNKNOWN = -5,       // no such car, ticket or asset
  CRUMPLE_NO_MEMORY = -6,     // no memory was left
  CRUMPLE_FAILED = -7,        // something else broke down: crumple_error says what
};

// The sentence for the last error of this thread. It stays valid until this thread calls the library again.
const char* crumple_error(void);

typedef struct Crumple Crumple;

typedef struct CrumpleOptions {
  uint32_t version;     // CRUMPLE_CLIENT_VERSION
  uint32_t timeout_ms;  // for the connection and for each command; 0: 2000
  const char* connect;  // "tcp/127.0.0.1:7447"; "tls/HOST:7447" if the server has a certificate; NULL: see crumple_feed
  const char* scene;
  const char* host;     // the id under which this session moves cars; NULL: a viewer only
  const char* network;  // Zenoh configuration (JSON5) that overrides ours: TLS, user, password; NULL or "": none
} CrumpleOptions;

// Waits until the session sees the server of the scene, for at most timeout_ms. The first session of a process sets
// RUST_MIN_STACK in the environment if it is not set (32 MiB of address space for each thread). No other thread may read the
// environment during this call.
int crumple_open(const CrumpleOptions*, Crumple** out);
// Waits until the other end has received everything that the session sent, for at most 1 s. A closed session stays closed: no
// other session ever gets its handle, and a second call does nothing.
void crumple_close(Crumple*);

// Takes in the messages that have arrived; if there are none, it waits for one for at most timeout_us. Returns the number of
// messages, or a negative CrumpleStatus.
int crumple_poll(Crumple*, uint64_t timeout_us);

typedef struct CrumpleStatistics {
  uint64_t received, received_bytes;  // all messages
  uint64_t surface, surface_bytes;    // the keyframes and deltas among them
  uint64_t older, refused, asked;     // dropped because the session held newer ones; malformed; queries for a keyframe
} CrumpleStatistics;
void crumple_statistics(const Crumple*, CrumpleStatistics* out);

// The server's time now, s, as in CrumpleReaction. The session estimates it from the fastest message of the last one or two
// seconds, so the time may be late by the time that a message travels, and may step a little. 0: no message has come yet.
// Without a network it is the time of the newest tick.
double crumple_time(const Crumple*);

// Simulates a bad link, to test a game on it. From now on the session delays or loses the poses that it sends, and every
// message that the server publishes: each message by itself, so messages overtake each other. Poses leave with the next
// crumple_poll. The same seed draws the same numbers. Commands, queries and their answers are not impaired. If all fields are
// 0, the link is good again as soon as the delayed messages have come.
typedef struct CrumpleImpairment {
  float delay, jitter;  // s, one way: each message takes between delay - jitter and delay + jitter, drawn evenly; up to 60
  float loss, repeat;   // shares of the messages, 0 to 1, that the link loses, and that come twice
  uint32_t seed;
} CrumpleImpairment;
int crumple_impair(Crumple*, const CrumpleImpairment*);

// Gives a message to a session without a network, which was opened without `connect`. The message may come from a recording, a
// test, or a transport of your own. key: the key of the message, which is its topic in a recording. The session ignores
// messages about cars that it does not follow. A malformed message changes nothing and returns CRUMPLE_BAD_ARGUMENT. If the
// session does not hold the keyframe of a delta, it increases CrumpleStatistics.asked: give it the keyframe.
int crumple_feed(Crumple*, const char* key, const void* bytes, size_t size);

// ---- commands: each function gives a ticket, and crumple_poll takes in the answer

typedef struct CrumplePose {
  double position[3];
  float orientation[4];
} CrumplePose;

typedef struct CrumpleSpawn {
  CrumplePose pose;
  float mass;        // kg; 0: the baked car's
  float inertia[3];  // kg m^2 about the centre of mass, along the car's axes; all 0: the baked car's, in proportion to mass
  float center_of_mass[3];  // m; all 0: the baked car's
  int planar;               // 1: the car is on its wheels, and contacts slow it in x, y and yaw only
} CrumpleSpawn;

// Begin with crumple_keep(), which keeps every parameter, and set the parameters that should change. server/sim/material.h has
// their ranges.
typedef struct CrumpleParameters {
  int solver;                     // 0 nodal, 1 classic; -1: keep
  uint32_t iterations, substeps;  // 0: keep
  float tolerance;                // NaN: keep
  int region;                     // index of the region for the fields below; -1: all
  float young_modulus, poisson_ratio, yield_strain, hardening, plastic_limit, drag;  // NaN: keep
  float hardening_strain, densification, densification_strain;                       // NaN: keep
  float friction;                                                                    // NaN: keep; on other cars
  float distance_stiffness, volume_stiffness, plasticity;                            // NaN: keep; of `classic`
} CrumpleParameters;
CrumpleParameters crumple_keep(void);

// asset: the hash of the baked car, 16 hexadecimal digits.
int crumple_spawn(Crumple*, const char* car, const char* asset, const CrumpleSpawn*, uint64_t* ticket);
int crumple_despawn(Crumple*, const char* car, uint64_t* ticket);
// amount: the share of the damage that the server takes away, in [0, 1].
int crumple_repair(Crumple*, const char* car, float amount, uint64_t* ticket);
int crumple_set_parameters(Crumple*, const char* car, const CrumpleParameters*, uint64_t* ticket);
// The state in the answer is the car's deformation. crumple_load gives this state to any car of the same asset.
int crumple_save(Crumple*, const char* car, uint64_t* ticket);
int crumple_load(Crumple*, const char* car, const void* state, size_t size, uint64_t* ticket);

typedef struct CrumpleAnswer {
  int ok;
  uint64_t tick;         // in which the server executed the command
  const char* sentence;  // if ok is 0: why the server refused
  const uint8_t* state;  // the answer to crumple_save
  size_t state_size;
} CrumpleAnswer;
// Returns CRUMPLE_OK if the answer is there (the session keeps the last 256), CRUMPLE_PENDING or CRUMPLE_NO_ANSWER.
int crumple_answer(Crumple*, uint64_t ticket, CrumpleAnswer* out);
// Polls until the answer is there or the timeout of the session has passed.
int crumple_wait(Crumple*, uint64_t ticket, CrumpleAnswer* out);

// ---- hosts

typedef struct CrumpleCarPose {
  const char* car;
  CrumplePose pose;           // where the host has the car now
  float velocity[3];          // of the centre of mass, m/s, world
  float angular_velocity[3];  // rad/s, world
  uint64_t seen;              // tick of the last reaction that pose and velocity contain; 0: the car follows a script
  float importance;           // in (0, 1]: how much the car matters now, by which the server chooses its level; 0: 1
} CrumpleCarPose;
// Sends all cars of this host in one message, which the session numbers. time: the host's clock, s.
int crumple_publish_poses(Crumple*, double time, const CrumpleCarPose* cars, size_t count);

enum CrumpleShape { CRUMPLE_BOX, CRUMPLE_SPHERE, CRUMPLE_CAPSULE, CRUMPLE_HALF_SPACE, CRUMPLE_HULL };

typedef struct CrumpleObstacle {
  uint32_t id;
  int shape;            // CrumpleShape
  float size[3];        // box: half extents; sphere: radius; capsule: radius, half the length of its axis (local z)
  const float* points;  // hull: 3 floats each
  size_t point_count;
  CrumplePose pose;
  float velocity[3], angular_velocity[3];  // the obstacle moves on with these
  float friction;                          // Coulomb's coefficient
} CrumpleObstacle;
// Sends the whole list of this host, which replaces its previous list.
int crumple_publish_obstacles(Crumple*, const CrumpleObstacle* obstacles, size_t count);

// Another car that touched the car of a reaction in the same tick, or at the end of the tick before.
typedef struct CrumplePartner {
  const char* car;
  const char* host;   // of that car
  float impulse[3];   // on the car of the reaction, N s, world; the other car got the opposite
  uint32_t contacts;  // between the two at the end of the tick
} CrumplePartner;

typedef struct CrumpleReaction {
  const char* car;
  uint64_t tick;
  double time;                           // s, by the server's ticks
  float impulse[3], angular_impulse[3];  // of this tick: N s, and N m s about the centre of mass; world
  CrumplePose pose;                      // at the end of the tick
  float velocity[3], angular_velocity[3];
  double energy_absorbed, energy_stored;  // J since spawn
  float deepest;                          // largest push of a node in this tick, m
  uint32_t contacts;
  uint32_t partner_count;  // 0: no car touched it
  // Sorted by the id of the car. Their impulses and those of obstacles add up to `impulse`. Valid until the next
  // crumple_take_reactions.
  const CrumplePartner* partners;
} CrumpleReaction;
// Gives reactions that were not taken yet, oldest first, and returns how many it gave. While more than 4096 wait, the session
// drops the oldest.
size_t crumple_take_reactions(Crumple*, CrumpleReaction* out, size_t capacity);

// ---- viewers

// From now on the session holds the surface of this car; NULL: of every car that is there or comes. level 0: the server sends
// the surface in every tick, in the scene's quantum; 1, for a viewer that is far away: ten times a second, in eight times that
// quantum. Call it again to change the level, as often as you like: the session keeps the surface that it holds until the first
// keyframe of the new level comes. In a crash this keyframe may be up to a second older than that surface.
int crumple_follow(Crumple*, const char* car, int level);
// Gives the ids of the cars that this session holds or follows, and returns how many there are.
size_t crumple_cars(const Crumple*, const char** ids, size_t capacity);

typedef struct CrumpleSurface {
  uint64_t tick;          // the newest tick of which the session holds every part
  uint64_t hash;          // XXH64 of the displacements in quanta, equal to the server's
  uint32_t node_count;    // number of nodes that the skin uses: vertices move with them
  float quantum;          // m; of the level that the session holds
  const char* asset;      // hash of the baked car
  const int16_t* quanta;  // 3 for each node: displacement from rest in quanta, car's frame
  int dirty;              // 1: crumple_copy has not given this surface yet; if you have several meshes, copy all of them then
  int alive;              // 0: the car was despawned, or its server is gone; without a network always 1
} CrumpleSurface;
// CRUMPLE_PENDING means: the session follows the car, but no whole surface has come yet; or nobody polled the session for half
// a second, and the current surface has not come since. Then keep what you drew.
int crumple_surface(Crumple*, const char* car, CrumpleSurface* out);

// crumple_copy writes 3 floats for each vertex to each of these places: separate arrays (stride 12), or members of your vertex
// struct (stride: its size). NULL: leave it out.
typedef struct CrumpleVertices {
  float* position;      // m
  float* displacement;  // from rest, m
  float* normal;        // of length 1; without a mapping: the mean of the triangles around the vertex, weighted by their area
  size_t stride;        // bytes from one vertex to the next
  size_t capacity;      // number of vertices that fit
  // 0 or less: the newest surface. Otherwise the surface at this time, s, which may be up to half a second ago; between two
  // ticks the vertices are on the way from the one to the other. With crumple_time() - 0.1 here, and for the poses, a car moves
  // smoothly however unevenly messages come.
  double time;
  // crumple_copy sets these: only the `count` vertices from `first` on may differ from the last crumple_copy of this car with
  // this mapping.
  uint32_t first, count;
  // 0: the vertices of crumple_mesh, in the car's frame. From crumple_map: the vertices of your own mesh, in its coordinates.
  uint32_t mapping;
  float* tangent;  // of length 1; only with a mapping whose mesh has tangents
} CrumpleVertices;
// crumple_copy needs the asset, as crumple_mesh does, asks the server for it, and returns CRUMPLE_PENDING until it has come.
int crumple_copy(Crumple*, const char* car, CrumpleVertices*);

// The undamaged car. The server sends it once for each asset.
typedef struct CrumpleMesh {
  uint32_t vertex_count, triangle_count;
  const float* vertex;       // 3 each, m, car's frame
  const uint32_t* triangle;  // 3 each
  float mass;                // kg
  float center_of_mass[3];   // m
  const char* name;
  const char* attribution;  // must be shown where the car is shown
} CrumpleMesh;
// Returns CRUMPLE_PENDING until the asset has come. The pointers stay valid as long as the session.
int crumple_mesh(Crumple*, const char* asset, CrumpleMesh* out);
// Takes a baked car that you have as a file, so that the server need not send it. hash: receives its hash for crumple_spawn.
int crumple_add_asset(Crumple*, const void* car, size_t size, char hash[17]);

enum CrumplePartKind {
  CRUMPLE_BODY,  // these four deform
  CRUMPLE_PANEL,
  CRUMPLE_GLASS,
  CRUMPLE_LIGHT,
  CRUMPLE_WHEEL,     // rigid
  CRUMPLE_INTERIOR,  // moves with the body around it
  CRUMPLE_POINT,     // a place without vertices, to which you attach something
};

// A part of a car. It has a frame of its own; position and orientation are the frame's at rest, in the car's frame. The origin
// is the hub of a wheel, which turns about y of its frame, and the middle of the vertices of other parts.
typedef struct CrumplePart {
  const char* name;
  int kind;              // CrumplePartKind
  float position[3];     // m
  float orientation[4];  // unit quaternion
  float radius, width;   // of a wheel, m
} CrumplePart;

typedef struct CrumpleParts {
  uint32_t count;              // 0: the car has only a body
  const CrumplePart* part;     // part 0 is the body
  const uint8_t* vertex_part;  // for each vertex of crumple_mesh the index of its part
} CrumpleParts;
// Returns CRUMPLE_PENDING until the asset has come. The pointers stay valid as long as the session.
int crumple_parts(Crumple*, const char* asset, CrumpleParts* out);

// Where the frame of a part is now, in the car's frame: it moves rigidly, as the body around it moves on average. Multiply it
// by the pose of the car to place a model of a wheel, a lamp or a camera in the world. time: as in CrumpleVertices. Returns
// CRUMPLE_PENDING as crumple_copy does.
int crumple_part_pose(Crumple*, const char* car, uint32_t part, double time, CrumplePose* out);

// A mesh of the car that you draw yourself.
typedef struct CrumpleOwnMesh {
  const float* position;  // 3 for each vertex
  const float* normal;    // 3, of length 1; NULL: it has none, and crumple_copy takes those of the baked car
  const float* tangent;   // 3, of length 1; NULL: it has none
  size_t stride;          // bytes from one vertex to the next
  size_t count;           // number of vertices, at most 4 million
  // Rows of the 3 x 4 matrix from these coordinates to the car's frame. NULL: they are the coordinates of the file from which
  // the car was baked, with the transformations of its nodes applied.
  const double* to_car;
  // crumple_map sets these:
  uint32_t on_vertices;  // number of vertices that lie on a vertex of the baked car, within 0.1 mm
  float farthest;        // m, from a vertex to the surface of the baked car
} CrumpleOwnMesh;
// Binds each vertex of your mesh to the surface of a baked car. With the mapping crumple_copy moves your vertices and turns
// your normals and tangents: in your order, with your seams and hard edges. At rest it gives your numbers. Map every mesh and
// every level of detail once; all get the same dents. The vertices of a wheel move rigidly with it. Leave out wheels that are
// not parts of the baked car, and place them yourself. mapping: a number, valid as long as the session; a session has at most
// 1024. Returns CRUMPLE_PENDING until the asset has come.
int crumple_map(Crumple*, const char* asset, CrumpleOwnMesh*, uint32_t* mapping);

typedef struct CrumpleHealth {
  uint64_t tick, late;      // late: number of ticks that began late
  float rate;               // ticks a second
  float tick_ms, worst_ms;  // duration of the ticks of the last second: mean and worst
  uint64_t refusals;        // messages that the server refused, for any reason
} CrumpleHealth;
int crumple_health(const Crumple*, CrumpleHealth* out);

#ifdef __cplusplus
}
#endif
