// Recordings: writes and reads MCAP files.
#pragma once

#include "io/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct Recorder Recorder;

// Creates the file and a thread that writes it: only whole records (no seeking back), in chunks of 256 KiB or one second,
// whichever comes first. It syncs every second, so data older than a second survives kill -9. Each call below copies its data
// into a bounded queue and returns at once. The queue holds 64 MiB; when it is full, calls return TRANSPORT_DROPPED and
// messages are counted. Attachments do not count as queued bytes, because the caller has them in memory anyway. Attachments and
// metadata are synced at once.
int recorder_open(const char* path, const char* profile, const char* library, Recorder** out);
// Declare a schema of encoding "flatbuffer" (data: .bfbs), and a channel with message encoding "flatbuffer". Return an id >= 0.
int recorder_schema(Recorder*, const char* name, const void* bfbs, size_t size);
int recorder_channel(Recorder*, const char* topic, int schema);
int recorder_write(Recorder*, int channel, uint32_t sequence, uint64_t log_time_ns, uint64_t publish_time_ns, const void* data,
                   size_t size);
int recorder_attach(Recorder*, const char* name, const char* media_type, const void* data, size_t size);
// pairs: key, value, key, value, ..., NULL.
int recorder_metadata(Recorder*, const char* name, const char* const* pairs);
// Number of messages that were not written, because the queue was full or the disk failed; and the first failure's sentence, or
// "".
uint64_t recorder_lost(const Recorder*);
const char* recorder_trouble(const Recorder*);
// Approximate memory, in bytes, that the file's index takes until it is closed. It grows with every channel and every chunk.
uint64_t recorder_index(const Recorder*);
// Writes the queue, the summary and the footer. Returns the Status of the first failure, if any.
int recorder_close(Recorder*);

typedef struct Reader Reader;

typedef struct ReaderMessage {
  const char* topic;
  const char* schema;  // its name and its .bfbs
  const uint8_t* bfbs;
  size_t bfbs_size;
  const uint8_t* data;  // aligned to 16 bytes; valid until the next reader_next or reader_rewind
  size_t size;
  uint32_t sequence;
  uint64_t log_time_ns, publish_time_ns;
} ReaderMessage;

// Opens a recording, whole or cut off at any byte (then reader_cut gives 1), with plain, LZ4 or zstd chunks. Refuses records
// over 256 MiB, chunks that unpack to over 64 MiB or 256 times their size, and over 64 MiB of schemas and topics.
int reader_open(const char* path, Reader** out);
void reader_close(Reader*);
int reader_cut(const Reader*);
// The next message in file order: 1, or 0 at the end, or a negative Status (damaged).
int reader_next(Reader*, ReaderMessage* out);
int reader_rewind(Reader*);
// The i-th attachment or metadata entry in file order: 1, or 0 if there are fewer. The pointers are valid as long as the
// Reader.
int reader_attachment(Reader*, uint32_t i, const char** name, const char** media_type, const uint8_t** data, size_t* size);
// Metadata: pairs as key, value, ..., NULL.
int reader_metadata(Reader*, uint32_t i, const char** name, const char* const** pairs);

#ifdef __cplusplus
}
#endif
