// The C interface of the project's only Rust: zenoh sessions, MCAP files, HTTP for Prometheus and for browsers. It does not
// interpret the bytes.
// The caller polls: there are no callbacks. Only net_poll, net_open and net_close wait.
// Functions that return int give 0, or a negative Status; then transport_error() has the sentence.
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
  TRANSPORT_DROPPED = -3,  // a bounded queue was full: the item was dropped and counted
  TRANSPORT_IO = -4,
  TRANSPORT_BAD_FILE = -5,
};

// The sentence for the last error of this thread; valid until the thread's next call.
const char* transport_error(void);
// The versions of zenoh, mcap and this library in one line.
const char* transport_version(void);

#ifdef __cplusplus
}
#endif
