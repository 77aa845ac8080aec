// The C door to the only Rust of the project: zenoh sessions, MCAP files, pages for Prometheus and for browsers. Nothing here
// knows what the bytes mean.
// Pull-based: no callback ever runs on the caller's side; no function but net_poll, net_open and net_close waits.
// Functions that return int give 0, or a negative Status; transport_error() then has the sentence.
#pragma once

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum TransportStatus {
  TRANSPORT_OK = 0,
  TRANSPORT_BAD_ARGUMENT = -1,
  TRANSPORT_CLOSED = -2,   // session or file is closed or broken
  TRANSPORT_DROPPED = -3,  // a bounded queue was full: the item was not taken, and counted
  TRANSPORT_IO = -4,
  TRANSPORT_BAD_FILE = -5,
};

// The sentence for the last error of this thread; valid until its next call.
const char* transport_error(void);
// zenoh, mcap and this library's versions as one line.
const char* transport_version(void);

// ---- network --------------------------------------------------------------------------------------------------------------

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

// ---- metrics --------------------------------------------------------------------------------------------------------------

typedef struct Metrics Metrics;

// Listens on "HOST:PORT" (port 0: any free one) and answers GET /metrics with the page that was set last, and
// crumple_http_refused_total after it; anything else is answered with 404. Threads of its own do it: metrics_set only copies.
//
// This door and that of pages (below) bound what comes: 64 and 512 connections at a time, half of them of one address (of IPv6,
// of one /64); 16 KiB and 10 s for the head of a request, and 10 s between two; 30 s for a reader that takes nothing. Where all
// places are taken, the connection goes that has moved nothing for longest, unless it waits for an answer or is a WebSocket.
int metrics_open(const char* address, Metrics** out);
// "127.0.0.1:9464", resolved.
const char* metrics_address(const Metrics*);
int metrics_set(Metrics*, const char* page);
void metrics_close(Metrics*);

// ---- pages for browsers ---------------------------------------------------------------------------------------------------

typedef struct Web Web;

// Listens on "HOST:PORT" (port 0: any free one) and answers GET with what web_page was given, and WebSockets at /live (up to
// 256, of one address up to 128) with a state: bytes under keys. A message there is a batch of what was set since the last one,
// each key once and in the order of setting, of up to 256 KiB or one key:
//   u16 size of the key, u32 size of the bytes, u32 ms since they were set, the key, the bytes     (little endian)
// The browser answers each batch with an empty binary message; it gets the next ones while no more than 4 are unanswered, and
// is let go when it answers nothing for 30 s. So one that is slow or frozen costs 4 batches, and finds the present when it goes
// on. Pages of other sites are refused by Origin and, on loopback, by Host, and none may show this one in a frame: every answer
// has a Content-Security-Policy, by which a page has its scripts and styles in it or from here. Threads of its own do all that.
int web_open(const char* address, Web** out);
// "127.0.0.1:8080", resolved.
const char* web_address(const Web*);
// Connections that were let go or not let in because too many were there.
uint64_t web_refused(const Web*);
// What is answered to GET path from now on.
int web_page(Web*, const char* path, const char* media_type, const void* data, size_t size);
int web_set(Web*, const char* key, const void* data, size_t size);
// Whoever comes from now on gets no page whose path and nothing of what is set under keys that begin so; the others are not
// told.
int web_forget(Web*, const char* prefix);
// From now on what browsers POST, up to 1 MiB each, waits for web_next: up to 64 that arrive or wait, half of them of one address,
// each for 30 s and 30 s.
// Before that they are refused.
int web_take_requests(Web*);
typedef struct WebRequest {
  uint64_t ticket;  // for web_answer
  const char* path;
  const uint8_t* data;  // any alignment
  size_t size;
} WebRequest;
// The request that waits longest: 1, or 0 if there is none. Its views are valid until the next call.
int web_next(Web*, WebRequest* out);
// Answers it, once, with a status of HTTP.
int web_answer(Web*, uint64_t ticket, uint16_t status, const char* media_type, const void* data, size_t size);
void web_close(Web*);

// ---- recordings: MCAP 0.26 ------------------------------------------------------------------------------------------------

typedef struct Recorder Recorder;

// Creates the file and a thread that writes it: whole records only (no seeking back), chunks of 256 KiB or one second,
// whichever comes first, synced each second: what is older than a second survives kill -9. Each call below takes a copy into
// a bounded queue (64 MiB; beyond it TRANSPORT_DROPPED, messages counted) and returns at once. Attachments do not count there:
// whoever gives them has their bytes in memory already. They and the metadata are synced at once.
int recorder_open(const char* path, const char* profile, const char* library, Recorder** out);
// Schema of encoding "flatbuffer" (data: .bfbs), and a channel with message encoding "flatbuffer". Return an id >= 0.
int recorder_schema(Recorder*, const char* name, const void* bfbs, size_t size);
int recorder_channel(Recorder*, const char* topic, int schema);
int recorder_write(Recorder*, int channel, uint32_t sequence, uint64_t log_time_ns, uint64_t publish_time_ns, const void* data,
                   size_t size);
int recorder_attach(Recorder*, const char* name, const char* media_type, const void* data, size_t size);
// pairs: key, value, key, value, ..., NULL.
int recorder_metadata(Recorder*, const char* name, const char* const* pairs);
// Messages that were not written: queue full or disk trouble. The sentence of the first trouble, or "".
uint64_t recorder_lost(const Recorder*);
const char* recorder_trouble(const Recorder*);
// Bytes of memory that the file's index takes until it is closed, about. It grows with every channel and every chunk.
uint64_t recorder_index(const Recorder*);
// Writes what is queued, summary and footer; returns the first trouble's Status, if any.
int recorder_close(Recorder*);

typedef struct Reader Reader;

typedef struct ReaderMessage {
  const char* topic;
  const char* schema;  // its name, and its .bfbs
  const uint8_t* bfbs;
  size_t bfbs_size;
  const uint8_t* data;  // aligned to 16 bytes; valid until the next reader_next or reader_rewind
  size_t size;
  uint32_t sequence;
  uint64_t log_time_ns, publish_time_ns;
} ReaderMessage;

// Opens a recording, whole or cut off at any byte (then reader_cut gives 1), whose chunks are plain, LZ4 or zstd. Refused are
// records over 256 MiB, chunks that hold over 64 MiB or 256 times what they take, and over 64 MiB of schemas and topics.
int reader_open(const char* path, Reader** out);
void reader_close(Reader*);
int reader_cut(const Reader*);
// The next message in file order: 1, or 0 at the end, or a negative Status (damaged).
int reader_next(Reader*, ReaderMessage* out);
int reader_rewind(Reader*);
// The i-th attachment or metadata entry in file order: 1, or 0 if there are fewer. Views live as long as the Reader.
int reader_attachment(Reader*, uint32_t i, const char** name, const char** media_type, const uint8_t** data, size_t* size);
// Metadata: pairs as key, value, ..., NULL.
int reader_metadata(Reader*, uint32_t i, const char** name, const char* const** pairs);

#ifdef __cplusplus
}
#endif
