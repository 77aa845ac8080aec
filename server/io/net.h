// Sessions of zenoh: publish, subscribe, query, answer, and liveliness tokens.
#pragma once

#include "io/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct Net Net;

// mode: "peer" or "router" with `listen` (and `connect`), or "client" with `connect`. Endpoints are such as
// "tcp/127.0.0.1:7447" or "udp/127.0.0.1:7447?rel=1" (QUIC, which sends lost packets again), comma separated, or NULL. config:
// JSON5 of zenoh's own configuration, overrides ours, or NULL. Ours: no multicast or gossip scouting, lease 3 s, 16 batches per
// queue, 64 MiB per message (a car of 50,000 nodes has 20), Drop for samples. A session that listens on port 0 learns its port
// from net_endpoint. net_open waits up to timeout_ms for a client's first connection. A lost connection comes back by itself.
int net_open(const char* mode, const char* listen, const char* connect, const char* config, uint32_t timeout_ms, Net** out);
// Whether zenoh would take this configuration (JSON5, not NULL); opens nothing.
int net_check(const char* config);
// The resolved endpoints on which the session listens ("tcp/127.0.0.1:41234"), comma separated, or "" if none.
const char* net_endpoint(const Net*);
// Undeclares everything, joins all threads.
void net_close(Net*);

enum NetPriority { NET_REAL_TIME = 1, NET_HIGH = 2, NET_DATA = 5, NET_LOW = 6 };  // zenoh's values

// Copies the data and returns at once; a thread of the session publishes in order. The first put on a key declares its
// publisher, which stays until net_withdraw; at most NET_KEYS, then TRANSPORT_DROPPED. A session does not receive its own
// samples and queries, but it does see its own announcements.
int net_put(Net*, const char* key, const void* data, size_t size, enum NetPriority priority);

// Undeclares all keys with this prefix (a car was despawned), until the next put on them.
int net_withdraw(Net*, const char* prefix);

enum { NET_LONGEST = 64 << 20, NET_KEYS = 8192 };  // most bytes of a received message; most keys that a session publishes on

// longest: most bytes of a delivered sample; longer ones are counted in NetStats.oversized.
// depth 0: only the latest sample per key; a newer sample replaces one that was not polled yet (counted in NetStats.replaced).
// Otherwise a queue of `depth` samples over all keys. New samples are dropped and counted when the queue is full, when depth is
// 0 and 4096 keys wait, or when 256 MiB wait in this session.
int net_subscribe(Net*, const char* key_expression, uint32_t depth, size_t longest);
// Whether the first sample is newer than the second. Must be quick and may be called on any thread. Data are aligned to 16
// bytes.
typedef int (*NetIsNewer)(const uint8_t* data, size_t size, const uint8_t* waiting, size_t waiting_size);
// The same with depth 0, but only a newer sample replaces the one that waits. Another is refused and counted in
// NetStats.overtaken.
int net_subscribe_newest(Net*, const char* key_expression, size_t longest, NetIsNewer);
// Preferred keys, comma separated, at most 256. Their samples are kept even if other keys fill a subscription of depth 0 or the
// 256 MiB. The list replaces the previous one.
int net_prefer(Net*, const char* keys);
// Ends every subscription with exactly this expression. Samples that arrived before can still be polled.
int net_unsubscribe(Net*, const char* key_expression);
// Queries on these keys arrive through net_poll. At most `depth` wait; further ones are refused, and so are queries with more
// than `longest` bytes. Received keys, here and elsewhere, have up to 256 bytes and may contain wildcards: check them. Answer
// each query; of more than 4,096 unanswered ones the oldest is given up.
int net_queryable(Net*, const char* key_expression, uint32_t depth, size_t longest);
// Sends a query. Its answers arrive through net_poll as NET_REPLY with this ticket, then one NET_REPLY_END, at the latest after
// timeout_ms. A timeout arrives as a failed NET_REPLY, then the end.
int net_get(Net*, const char* key, const void* data, size_t size, uint32_t timeout_ms, uint64_t* ticket);
// net_announce: announces under a key that this session is alive, until it closes. net_watch: reports such keys, first those
// alive now.
int net_announce(Net*, const char* key);
// Takes an announcement back earlier (a car was despawned).
int net_retract(Net*, const char* key);
int net_watch(Net*, const char* key_expression);
// 1 if some other session subscribes to the key now: a cached flag, cheap. The first call or put declares the key; 0 until
// then.
int net_matching(Net*, const char* key);
// 1 if this session is linked to another one now. When the last link is lost, all live tokens are reported gone, but then only
// the own link is known to be down.
int net_connected(Net*);

enum NetKind { NET_SAMPLE, NET_QUERY, NET_REPLY, NET_REPLY_END, NET_ALIVE, NET_GONE };

typedef struct NetEvent {
  uint32_t kind;        // NetKind
  uint32_t failed;      // NET_REPLY: 1 if it is an error reply
  const char* key;      // zero-terminated
  const uint8_t* data;  // aligned to 16 bytes
  size_t size;
  uint64_t ticket;  // NET_QUERY: for net_reply; NET_REPLY, NET_REPLY_END: from net_get
} NetEvent;

// Waits until something arrives or timeout_us has passed (0: does not wait). Fills in up to `capacity` events, samples in the
// order of their arrival, and at most one sample of each key of a subscription of depth 0. Returns their number, or a negative
// Status. Events are valid until the next net_poll of this Net. Only one thread at a time may poll a Net; all other functions
// may be called from any thread.
int net_poll(Net*, NetEvent* events, uint32_t capacity, uint64_t timeout_us);

// Answers a query, once (as an error reply if failed). An unanswered query times out at the asker. The answer has the
// queryable's key, or the query's key if the queryable names many.
int net_reply(Net*, uint64_t ticket, const void* data, size_t size, int failed);

typedef struct NetStats {
  uint64_t put, put_bytes, put_dropped;  // dropped: the session's own queue was full
  uint64_t received, received_bytes, received_dropped, oversized, replaced, overtaken;
  uint64_t queries, queries_refused;
  uint64_t keys;            // keys on which it publishes
  uint64_t frames_refused;  // messages to this process's sessions that zenoh.patch refused
} NetStats;
void net_stats(const Net*, NetStats* out);

#ifdef __cplusplus
}
#endif
