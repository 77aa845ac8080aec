// Copies the recording, record by record, up to the last TickEnd, and leaves out what follows: a replay would take inputs of an
// unfinished tick into the next tick, and that tick's outputs may be incomplete. The copy keeps times, sequence numbers and
// schemas, and its metadata name the program that recorded. Its end states how much it holds now, and that there was more.
#include "recording/recover.h"

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <filesystem>
#include <map>
#include <memory>
#include <stdexcept>
#include <thread>

#include "recording/recording.h"

namespace crumple {
namespace {

using ReaderHandle = std::unique_ptr<Reader, void (*)(Reader*)>;

struct Found {
  uint64_t ticks = 0, messages = 0;
  uint32_t last = 0;   // last finished tick
  uint64_t after = 0;  // messages after its TickEnd
  std::string damage;  // why the rest of the file cannot be read
};

int need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
  return status;
}

// Unlike a tick, a copy has the time to wait for the recorder's queue.
template <class Step>
int done(Step step) {
  return need(when_there_is_room(step));
}

ReaderHandle open(const std::string& path) {
  Reader* reader = nullptr;
  need(reader_open(path.c_str(), &reader));
  return {reader, reader_close};
}

double rate_of(Reader* reader, const std::string& path) {
  const char* name;
  const char* const* pairs;
  for (uint32_t i = 0; reader_metadata(reader, i, &name, &pairs) == 1; ++i)
    for (; std::strcmp(name, "crumple") == 0 && pairs[0]; pairs += 2)
      if (std::strcmp(pairs[0], "rate") == 0) return std::atof(pairs[1]);
  throw std::runtime_error(
      path + ": the file has no metadata \"crumple\" with a rate: it is not a recording of `crumple serve --record`");
}

Found survey(Reader* reader) {
  Found found;
  ReaderMessage message;
  int status;
  while ((status = reader_next(reader, &message)) == 1) {
    ++found.messages;
    if (std::strcmp(message.schema, table_of(Channel::tick_end)) == 0) {
      ++found.ticks;
      found.last = message.sequence;
      found.after = 0;
    }
    found.after += message.sequence > found.last;  // the health of the last tick comes after its end
  }
  if (status < 0) found.damage = transport_error();
  need(reader_rewind(reader));
  return found;
}

// Removes an unfinished copy: it would pass for the whole recording.
struct Unfinished {
  std::string path;
  int before = std::uncaught_exceptions();
  ~Unfinished() {
    std::error_code none;
    if (std::uncaught_exceptions() > before && std::filesystem::is_regular_file(path, none))
      std::filesystem::remove(path, none);
  }
};

void copy(Reader* reader, uint32_t last, RecordingEnd end, const std::string& path) {
  Recorder* recorder = nullptr;
  need(recorder_open(path.c_str(), "crumple", program_name, &recorder));
  std::unique_ptr<Recorder, int (*)(Recorder*)> closer(recorder, recorder_close);
  const Unfinished unfinished{path};
  const char *name, *type;
  const char* const* pairs;
  for (uint32_t i = 0; reader_metadata(reader, i, &name, &pairs) == 1; ++i)
    if (std::strcmp(name, end_name) != 0) done([&] { return recorder_metadata(recorder, name, pairs); });
  const uint8_t* data;
  size_t size;
  for (uint32_t i = 0; reader_attachment(reader, i, &name, &type, &data, &size) == 1; ++i)
    done([&] { return recorder_attach(recorder, name, type, data, size); });
  std::map<std::string, int> schemas, channels;
  for (ReaderMessage m; reader_next(reader, &m) == 1;) {
    if (m.sequence > last) continue;
    const auto [schema, new_schema] = schemas.try_emplace(m.schema);
    if (new_schema) schema->second = done([&] { return recorder_schema(recorder, m.schema, m.bfbs, m.bfbs_size); });
    const auto [channel, new_channel] = channels.try_emplace(m.topic);
    const int of_schema = schema->second;
    if (new_channel) channel->second = done([&] { return recorder_channel(recorder, m.topic, of_schema); });
    const int id = channel->second;
    done([&] { return recorder_write(recorder, id, m.sequence, m.log_time_ns, m.publish_time_ns, m.data, m.size); });
    ++end.messages;
  }
  if (end.there) write_end(recorder, end);
  need(recorder_close(closer.release()));
}

}  // namespace

int recover(const RecoverOptions& options) {
  std::error_code none;
  if (std::filesystem::equivalent(options.input, options.output, none))
    throw std::runtime_error(options.output + ": this is the input file: give -o another file");
  const ReaderHandle reader = open(options.input);
  const double rate = rate_of(reader.get(), options.input);
  const Found found = survey(reader.get());
  if (found.ticks == 0) throw std::runtime_error(options.input + ": the file has no whole tick: there is nothing to recover");
  const bool cut = reader_cut(reader.get()) == 1;
  const RecordingEnd end = end_of(reader.get());
  const std::string trouble = cut || !found.damage.empty() ? "" : trouble_at_end(end, found.ticks, found.messages);
  const bool whole = !cut && found.damage.empty() && found.after == 0 && trouble.empty();
  // A whole file without an end may or may not be complete.
  const bool known = end.there || !whole;
  copy(reader.get(), found.last, {found.ticks, 0, end.recovered || !whole, known}, options.output);

  std::printf("%s: %llu ticks (%.1f s) of %s, as a whole recording\n", options.output.c_str(),
              static_cast<unsigned long long>(found.ticks), static_cast<double>(found.ticks) / rate, options.input.c_str());
  if (!found.damage.empty()) std::printf("lost: everything after tick %u; %s\n", found.last, found.damage.c_str());
  if (cut) std::printf("lost: everything after tick %u that had not reached the file, about a second\n", found.last);
  if (!trouble.empty()) std::printf("lost: %s\n", trouble.c_str());
  if (found.after > 0)
    std::printf("left out: %llu messages of tick %u, because the end of this tick is not in the file\n",
                static_cast<unsigned long long>(found.after), found.last + 1);
  if (whole) std::printf("nothing was lost: the recording was whole already\n");
  return 0;
}

}  // namespace crumple
