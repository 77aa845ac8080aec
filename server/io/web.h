// Pages and WebSockets for browsers.
#pragma once

#include "io/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

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
// From now on what browsers POST, up to 1 MiB each, waits for web_next: up to 64 that arrive or wait, half of them of one
// address, each for 30 s and 30 s. Before that they are refused.
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

#ifdef __cplusplus
}
#endif
