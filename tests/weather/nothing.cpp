// The other functions of server/io, which no schedule may call. If a function is missing here, the linker takes the real
// library, and reports that the functions of network.cpp are defined twice.
#include <cstdio>
#include <cstdlib>

#include "io/mcap.h"
#include "io/metrics.h"

namespace {

[[noreturn]] void unexpected(const char* what) {
  std::fprintf(stderr, "crumple_weather: %s was called: no schedule records, or shows pages\n", what);
  std::abort();
}

}  // namespace

int metrics_open(const char*, Metrics**) { unexpected("metrics_open"); }
const char* metrics_address(const Metrics*) { unexpected("metrics_address"); }
int metrics_set(Metrics*, const char*) { unexpected("metrics_set"); }
void metrics_close(Metrics* metrics) {
  if (metrics) unexpected("metrics_close");
}
int recorder_open(const char*, const char*, const char*, Recorder**) { unexpected("recorder_open"); }
int recorder_schema(Recorder*, const char*, const void*, size_t) { unexpected("recorder_schema"); }
int recorder_channel(Recorder*, const char*, int) { unexpected("recorder_channel"); }
int recorder_write(Recorder*, int, uint32_t, uint64_t, uint64_t, const void*, size_t) { unexpected("recorder_write"); }
int recorder_attach(Recorder*, const char*, const char*, const void*, size_t) { unexpected("recorder_attach"); }
int recorder_metadata(Recorder*, const char*, const char* const*) { unexpected("recorder_metadata"); }
uint64_t recorder_lost(const Recorder*) { unexpected("recorder_lost"); }
const char* recorder_trouble(const Recorder*) { unexpected("recorder_trouble"); }
uint64_t recorder_index(const Recorder*) { unexpected("recorder_index"); }
int recorder_close(Recorder* recorder) {
  if (recorder) unexpected("recorder_close");
  return TRANSPORT_OK;
}
int reader_open(const char*, Reader**) { unexpected("reader_open"); }
void reader_close(Reader* reader) {
  if (reader) unexpected("reader_close");
}
int reader_cut(const Reader*) { unexpected("reader_cut"); }
int reader_next(Reader*, ReaderMessage*) { unexpected("reader_next"); }
int reader_rewind(Reader*) { unexpected("reader_rewind"); }
int reader_attachment(Reader*, uint32_t, const char**, const char**, const uint8_t**, size_t*) {
  unexpected("reader_attachment");
}
int reader_metadata(Reader*, uint32_t, const char**, const char* const**) { unexpected("reader_metadata"); }
