// Sessions of zenoh: publish, subscribe, ask, answer, and tokens of those that live.
#pragma once

#include "io/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct Net Net;

// mode "peer" or "router" with `listen` (and `connect`), or "client" with `connect`: endpoints such as "tcp/127.0.0.1:7447" or
// "udp/127.0.0.1:7447?rel=1" (QUIC: what is lost is sent again), comma separated, or NULL. config: JSON5 of
// zenoh's own configuration laid over ours, or NULL. Ours: no multicast or gossip scouting, lease 3 s, 16 batches a queue,
// 64 MiB a message (a car of 50,000 nodes has 20), Drop for samples. A server that listens on port 0 learns its port by
// net_endpoint. Waits up to timeout_ms for a client's first connection; one that is lost comes back by itself.
int net_open(const char* mode, const char* listen, const char* connect, const char* config, uint32_t timeout_ms, Net** out);
// Whether zenoh would take this configuration (JSON5, not NULL); opens nothing.
int net_check(const char* config);
// The endpoints the session listens on, resolved ("tcp/127.0.0.1:41234"), comma separated, or "" if none.
const char* net_endpoint(const Net*);
// Undeclares everything, joins all threads.
void net_close(Net*);

enum NetPriority { NET_REAL_TIME = 1, NET_HIGH = 2, NET_DATA = 5, NET_LOW = 6 };  // zenoh's

// Takes a copy and returns at once; a thread of the session publishes in order. Publishers are declared once a key and kept
// until they are withdrawn, NET_KEYS at most: beyond them TRANSPORT_DROPPED. A session does not hear its own samples and
// questions; it does see its own announcements.
int net_put(Net*, const char* key, const void* data, size_t size, enum NetPriority priority);

// Nothing more is published on the keys that begin so (a car was despawned), until something is.
int net_withdraw(Net*, const char* prefix);

enum { NET_LONGEST = 64 << 20, NET_KEYS = 8192 };  // bytes of a message that a session receives; keys that it publishes on

// longest: bytes of a sample that is handed on; longer ones are counted in NetStats.oversized.
// depth 0: latest only, per key (an older sample that was not yet polled is replaced, and counted in NetStats.replaced).
// Otherwise a queue of that many samples over all keys; beyond it, or beyond 4096 keys with depth 0, or beyond 256 MiB of all
// that waits in this session, new ones are dropped and counted.
int net_subscribe(Net*, const char* key_expression, uint32_t depth, size_t longest);
// What comes under these keys, comma separated, 256 at most, waits also where the others fill a subscription of depth 0, or the
// 256 MiB. They take the place of those before.
int net_prefer(Net*, const char* keys);
// Ends every subscription with this very expression. What has arrived before still comes.
int net_unsubscribe(Net*, const char* key_expression);
// Queries on these keys arrive by net_poll, at most `depth` waiting; beyond it they are refused, as are those that bring more
// than `longest` bytes. Keys that came, here and elsewhere, have up to 256 bytes and may be key expressions, with wildcards:
// what they name is to be checked. Each query is to be answered; of those that are not, the oldest beyond 4,096 is given up.
int net_queryable(Net*, const char* key_expression, uint32_t depth, size_t longest);
// Asks; the answers arrive by net_poll as NET_REPLY with this ticket, then one NET_REPLY_END, at the latest after timeout_ms
// (a timeout itself comes as a failed NET_REPLY, then the end).
int net_get(Net*, const char* key, const void* data, size_t size, uint32_t timeout_ms, uint64_t* ticket);
// Announces that this session lives, under a key, until it closes; and watches such keys (those alive now are reported first).
int net_announce(Net*, const char* key);
// Takes an announcement back before that (a car was despawned).
int net_retract(Net*, const char* key);
int net_watch(Net*, const char* key_expression);
// 1 if some other session subscribes to the key now; a cached flag, cheap. The first call, or put, declares the key: 0 until
// then.
int net_matching(Net*, const char* key);
// 1 if this session is linked to another one now. Where the last link goes, all that was alive is reported gone: only its own
// line is known to be cut then.
int net_connected(Net*);

enum NetKind { NET_SAMPLE, NET_QUERY, NET_REPLY, NET_REPLY_END, NET_ALIVE, NET_GONE };

typedef struct NetEvent {
  uint32_t kind;        // NetKind
  uint32_t failed;      // NET_REPLY: 1 if it is an error reply
  const char* key;      // zero-terminated
  const uint8_t* data;  // aligned to 16 bytes
  size_t size;
  uint64_t ticket;  // NET_QUERY: for net_reply; NET_REPLY, NET_REPLY_END: of net_get
} NetEvent;

// Waits until something arrived or timeout_us passed (0: does not wait); fills up to `capacity` events, samples in the order
// they came. Returns their number, or a negative Status. Events are valid until the next net_poll of this Net.
// One thread at a time polls a Net; every other function may be called from any thread.
int net_poll(Net*, NetEvent* events, uint32_t capacity, uint64_t timeout_us);

// Answers a query, once (as an error reply if failed); one that is never answered times out at the asker. The answer has the
// queryable's key, or the key asked for where the queryable's names many.
int net_reply(Net*, uint64_t ticket, const void* data, size_t size, int failed);

typedef struct NetStats {
  uint64_t put, put_bytes, put_dropped;  // dropped: the session's own queue was full
  uint64_t received, received_bytes, received_dropped, oversized, replaced;
  uint64_t queries, queries_refused;
  uint64_t keys;            // that it publishes on
  uint64_t frames_refused;  // messages of this process's sessions that zenoh.patch refuses
} NetStats;
void net_stats(const Net*, NetStats* out);

#ifdef __cplusplus
}
#endif
