// One page for Prometheus.
#pragma once

#include "io/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

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

#ifdef __cplusplus
}
#endif
