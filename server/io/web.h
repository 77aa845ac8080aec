// HTTP pages and WebSockets for browsers.
#pragma once

#include "io/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct Web Web;

// Listens on "HOST:PORT" (port 0: any free one). Answers GET with the pages of web_page. Serves WebSockets at /live (up to 256,
// up to 128 from one address) with a state: bytes under keys. Each WebSocket message is a batch of what was set since the last
// one, each key once, in the order of setting, up to 256 KiB or one key. Per key:
//   u16 size of the key, u32 size of the bytes, u32 ms since they were set, the key, the bytes     (little endian)
// The browser answers each batch with an empty binary message. It gets further batches while fewer than 4 are unanswered, and
// is disconnected when it answers nothing for 30 s. So a slow or frozen browser costs 4 batches, and later continues with the
// present state. Requests from pages of other sites are refused by Origin and, on loopback, by Host. Every answer has a
// Content-Security-Policy: a page may use scripts and styles only from itself or from this server, and no page may show it in a
// frame. The server has its own threads.
int web_open(const char* address, Web** out);
// The resolved address, such as "127.0.0.1:8080".
const char* web_address(const Web*);
// Connections that were closed or refused because there were too many.
uint64_t web_refused(const Web*);
// Sets the answer to GET path.
int web_page(Web*, const char* path, const char* media_type, const void* data, size_t size);
int web_set(Web*, const char* key, const void* data, size_t size);
// Removes the pages, and the part of the state, whose path or key has this prefix. Browsers that are connected are not told.
int web_forget(Web*, const char* prefix);
// From now on browsers' POST requests, up to 1 MiB each, wait for web_next. At most 64 may arrive or wait, half of them from
// one address; each has 30 s to arrive and 30 s to be answered. Before this call POST is refused.
int web_take_requests(Web*);
typedef struct WebRequest {
  uint64_t ticket;  // for web_answer
  const char* path;
  const uint8_t* data;  // any alignment
  size_t size;
} WebRequest;
// The request that has waited longest: 1, or 0 if there is none. Its pointers are valid until the next call.
int web_next(Web*, WebRequest* out);
// Answers a request, once, with an HTTP status.
int web_answer(Web*, uint64_t ticket, uint16_t status, const char* media_type, const void* data, size_t size);
void web_close(Web*);

#ifdef __cplusplus
}
#endif
