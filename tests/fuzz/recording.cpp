// Fuzzes a recording from a file with every verb that reads one.
#include "recording/recording.h"

#include <cstring>
#include <filesystem>
#include <stdexcept>

#include "cli/info.h"
#include "fuzz/small_world.h"
#include "host.h"
#include "recording/export.h"
#include "recording/recover.h"
#include "recording/replay.h"
#include "tick/budget.h"
#include "tick/hash.h"
#include "tick/health.h"
#include "tick/snapshot.h"

namespace crumple::fuzz {
namespace {

// Reports refusals of the verb to libFuzzer, because half of them come from Rust.
template <class Verb>
bool try_verb(const Verb& verb) {
  try {
    verb();
    return true;
  } catch (const std::runtime_error& refused) {
    saw(std::string_view(refused.what()).substr(std::min(std::strlen(refused.what()), std::strlen("/proc/self/fd/"))));
    return false;
  }
}

// Good inputs are copies without schemas, which would be most of the bytes, and without checksums, so that a change of one byte
// has an effect.
struct Source {
  Reader* reader = nullptr;
  explicit Source(const std::string& path) { expect(reader_open(path.c_str(), &reader) == 0, "a seed can be read"); }
  ~Source() { reader_close(reader); }
  Source(const Source&) = delete;
  Source& operator=(const Source&) = delete;
};

// One LZ4 chunk.
std::vector<uint8_t> compressed(const std::string& path) {
  const Source from(path);
  const MemoryFile copy;
  Recorder* recorder = nullptr;
  expect(recorder_open(copy.path().c_str(), "crumple", program_name, &recorder) == 0, "a seed can be written");
  const char *name, *type;
  const char* const* pairs;
  const uint8_t* data;
  size_t size;
  for (uint32_t i = 0; reader_metadata(from.reader, i, &name, &pairs) == 1; ++i) recorder_metadata(recorder, name, pairs);
  for (uint32_t i = 0; reader_attachment(from.reader, i, &name, &type, &data, &size) == 1; ++i)
    recorder_attach(recorder, name, type, data, size);
  std::map<std::string, int> schemas, channels;
  for (ReaderMessage m; reader_next(from.reader, &m) == 1;) {
    const auto schema = schemas.try_emplace(m.schema);
    if (schema.second) schema.first->second = recorder_schema(recorder, m.schema, nullptr, 0);
    const auto channel = channels.try_emplace(m.topic);
    if (channel.second) channel.first->second = recorder_channel(recorder, m.topic, schema.first->second);
    recorder_write(recorder, channel.first->second, m.sequence, m.log_time_ns, m.publish_time_ns, m.data, m.size);
  }
  recorder_close(recorder);
  std::vector<uint8_t> bytes = copy.bytes();
  for (size_t at = 8; at + 9 < bytes.size();) {  // opcode, size, body
    uint64_t body = 0;
    std::memcpy(&body, &bytes[at + 1], sizeof body);
    const uint8_t opcode = bytes[at];
    if (opcode == 0x06) std::memset(&bytes[at + 9 + 24], 0, 4);  // checksum of a chunk, after two times and a size
    if (opcode == 0x0f) std::memset(&bytes[at + 9], 0, 4);       // checksum of all data
    at += 9 + body;
  }
  return bytes;
}

class Record {
 public:
  explicit Record(uint8_t opcode) : opcode_(opcode) {}
  template <class Number>
  Record& number(Number value) {
    const auto* begin = reinterpret_cast<const uint8_t*>(&value);
    return data({begin, sizeof value});
  }
  Record& data(Input data) {
    body_.insert(body_.end(), data.begin(), data.end());
    return *this;
  }
  Record& text(const char* text) {
    const auto size = std::strlen(text);
    return number(uint32_t(size)).data({reinterpret_cast<const uint8_t*>(text), size});
  }
  void to(std::vector<uint8_t>& out) const {
    const auto size = uint64_t(body_.size());
    const auto* begin = reinterpret_cast<const uint8_t*>(&size);
    out.push_back(opcode_);
    out.insert(out.end(), begin, begin + sizeof size);
    out.insert(out.end(), body_.begin(), body_.end());
  }
  Input body() const { return body_; }

 private:
  uint8_t opcode_;
  std::vector<uint8_t> body_;
};

// Not compressed, without an index; with one chunk or none.
std::vector<uint8_t> plain(const std::string& path, bool chunk) {
  const Source from(path);
  std::vector<uint8_t> bytes = {0x89, 'M', 'C', 'A', 'P', '0', '\r', '\n'}, records;
  Record(0x01).text("crumple").text("").to(bytes);
  const char *name, *type;
  const char* const* pairs;
  const uint8_t* data;
  size_t size;
  for (uint32_t i = 0; reader_metadata(from.reader, i, &name, &pairs) == 1; ++i) {
    Record map(0);
    for (; pairs[0]; pairs += 2) map.text(pairs[0]).text(pairs[1]);
    Record(0x0c).text(name).number(uint32_t(map.body().size())).data(map.body()).to(bytes);
  }
  for (uint32_t i = 0; reader_attachment(from.reader, i, &name, &type, &data, &size) == 1; ++i) {
    Record attachment(0x09);
    attachment.number(uint64_t(0)).number(uint64_t(0)).text(name).text(type).number(uint64_t(size));
    attachment.data({data, size}).number(uint32_t(0)).to(bytes);
  }
  std::map<std::string, uint16_t> channels, schemas;
  for (ReaderMessage m; reader_next(from.reader, &m) == 1;) {
    const auto schema = schemas.try_emplace(m.schema, schemas.size() + 1);
    const uint16_t schema_id = schema.first->second;
    if (schema.second) Record(0x03).number(schema_id).text(m.schema).text("").number(uint32_t(0)).to(records);
    const auto channel = channels.try_emplace(m.topic, channels.size() + 1);
    const uint16_t id = channel.first->second;
    if (channel.second) Record(0x04).number(id).number(schema_id).text(m.topic).text("").number(uint32_t(0)).to(records);
    Record message(0x05);
    message.number(id).number(m.sequence).number(m.log_time_ns).number(m.publish_time_ns).data({m.data, m.size}).to(records);
  }
  const auto whole = uint64_t(records.size());
  if (chunk) {
    Record of(0x06);
    of.number(uint64_t(0)).number(uint64_t(0)).number(whole).number(uint32_t(0)).text("").number(whole).data(records).to(bytes);
  } else {
    bytes.insert(bytes.end(), records.begin(), records.end());
  }
  Record(0x0f).number(uint32_t(0)).to(bytes);
  return bytes;
}

void record(const std::string& path, bool begun) {
  const WorldHandle world = small_world();
  if (begun) advance(*world, {{"car/c1", host::spawn(coarse_car()->hash, "h0"), 1}});
  RecordingHead head;
  head.scene = "main";
  head.started = "now";
  head.limits.cars = 4;
  head.limits.hosts = 3;
  head.cars = {fine_car(), coarse_car()};
  if (begun) head.world = save_world(*world);
  Recording recording(open_recorder(path), head);
  Outbox outbox;
  shown(*world, outbox);
  for (const Message& message : outbox) recording.output(tick_count(*world), message, 0);
  const host::Thing wall{1, schema::Shape::box, {0.5f, 5, 5}, host::pose_at(2.85, 0, 1)};
  for (uint64_t k = 1; k <= 3; ++k) {
    Inbox inbox = {{"host/h0/poses", host::poses(k, {{"c0", host::pose_at(0.2 * double(k)), {14, 0, 0}}})}};
    if (k == 1) inbox = {{"car/c0", host::spawn(fine_car()->hash, "h0"), 1}, {"host/h0/obstacles", host::obstacles(1, {wall})}};
    inbox.push_back(budget_message(1));
    const uint64_t number = tick_count(*world) + 1, time = 1'000 * k;
    for (const Message& message : inbox) recording.input(number, message, time);
    tick(*world, inbox, outbox, 1);
    for (const Message& message : outbox) recording.output(number, message, time);
    recording.end_tick(number, hash(*world), time);
    recording.output(number, health(*world, 0, {}), time);  // like serve
  }
}

}  // namespace

bool recording_run(Input input) {
  const MemoryFile file(input), copy;
  const std::string path = file.path();
  static const std::string folder = std::filesystem::temp_directory_path() / ("fuzz" + std::to_string(getpid()));
  const std::atomic<bool> stop{false};
  bool taken = true;
  taken &= try_verb([&] {
    RecordingReader reader(path);
    for (RecordingReader::Item item; reader.next(item);) saw(item.key);
  });
  taken &= try_verb([&] { info({path}); });
  ReplayOptions again;
  again.files = {path};
  again.verify = true;
  again.threads = 1;
  taken &= try_verb([&] { taken &= replay(again, stop) == 0; });
  taken &= try_verb([&] { export_recording({.file = path, .folder = folder, .fps = 60}); });
  std::filesystem::remove_all(folder);
  taken &= try_verb([&] {
    recover({path, copy.path()});
    RecordingReader whole(copy.path());
    expect(!whole.cut(), "what was recovered is whole");
    for (RecordingReader::Item item; whole.next(item);) {
    }
  });
  return taken;
}

std::vector<std::vector<uint8_t>> recording_seeds() {
  std::vector<std::vector<uint8_t>> seeds;
  for (const bool begun : {false, true}) {
    const MemoryFile file;
    record(file.path(), begun);
    if (!begun) seeds.push_back(compressed(file.path()));
    seeds.push_back(plain(file.path(), begun));
  }
  return seeds;
}

}  // namespace crumple::fuzz
