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

#ifdef __cplusplus
}
#endif
