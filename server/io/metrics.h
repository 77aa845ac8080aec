// One page for Prometheus.
#pragma once

#include "io/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct Metrics Metrics;

// Listens on "HOST:PORT" (port 0: any free one). Answers GET /metrics with the last page that was set, followed by
// crumple_http_refused_total, and everything else with 404. It has its own threads; metrics_set only copies.
//
// This server and that of web.h have bounds: 64 and 512 connections at a time, half of them from one address (for IPv6, one
// /64); 16 KiB and 10 s for the head of a request, and 10 s between two requests; 30 s for a reader that takes nothing. When
// all places are taken, the connection that was idle for longest is closed, except those that wait for an answer or are
// WebSockets.
int metrics_open(const char* address, Metrics** out);
// The resolved address, such as "127.0.0.1:9464".
const char* metrics_address(const Metrics*);
int metrics_set(Metrics*, const char* page);
void metrics_close(Metrics*);

#ifdef __cplusplus
}
#endif
