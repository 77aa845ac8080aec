#include "recording.h"

#include <charconv>
#include <cstring>
#include <stdexcept>

#include "schema/message_generated.h"
#include "wire/decode.h"

// The schema of all messages, in the file: a recording explains itself to any MCAP tool.
asm(".pushsection .rodata\n.balign 8\nmessage_schema:\n.incbin \"" CRUMPLE_MESSAGE_BFBS "\"\nmessage_schema_end:\n.popsection");
extern "C" const uint8_t message_schema[], message_schema_end[];

namespace crumple {

const char* const program_name = "crumple 0.1.0+" CRUMPLE_PHYSICS;

namespace {

// Hosts and cars come and go, and each has keys of its own; MCAP numbers channels with 16 bits.
constexpr size_t channel_limit = 60'000;

template <class Visit>
void visit_limits(Limits& limits, Visit visit) {
  visit("limit_cars", limits.cars);
  visit("limit_hosts", limits.hosts);
  visit("limit_obstacles_per_host", limits.obstacles_per_host);
  visit("limit_hull_points_per_host", limits.hull_points_per_host);
  visit("limit_message_size", limits.message_size);
  visit("limit_id_length", limits.id_length);
  visit("limit_farthest", limits.farthest);
  visit("limit_fastest", limits.fastest);
  visit("limit_fastest_turn", limits.fastest_turn);
  visit("limit_thinnest", limits.thinnest);
  visit("limit_widest", limits.widest);
  visit("limit_roughest", limits.roughest);
  visit("limit_heaviest", limits.heaviest);
  visit("limit_greatest_inertia", limits.greatest_inertia);
  visit("limit_farthest_center", limits.farthest_center);
}

template <class Number>
std::string text_of(Number value) {  // the shortest that reads back as the same bits
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

template <class Number>
bool read_number(const std::string& text, Number& value) {
  return std::from_chars(text.data(), text.data() + text.size(), value).ec == std::errc();
}

void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

}  // namespace

const char* table_of(Channel channel) {
  switch (channel) {
    case Channel::poses:
      return "crumple.schema.Poses";
    case Channel::obstacles:
      return "crumple.schema.Obstacles";
    case Channel::budget:
      return "crumple.schema.Budget";
    case Channel::asset:
      return "crumple.schema.Asset";
    case Channel::command:
      return "crumple.schema.Command";
    case Channel::reactions:
      return "crumple.schema.Reactions";
    case Channel::keyframe:
      return "crumple.schema.Keyframe";
    case Channel::delta:
      return "crumple.schema.Delta";
    case Channel::answer:
      return "crumple.schema.Answer";
    case Channel::health:
      return "crumple.schema.Health";
    case Channel::tick_end:
      return "crumple.schema.TickEnd";
    default:
      return "";
  }
}

Recording::Recording(const std::string& path, const RecordingHead& head) : root_(root_of(head.scene)) {
  need(recorder_open(path.c_str(), "crumple", head.program.c_str(), &recorder_));
  std::vector<std::string> pairs = {"program", head.program,       "scene",   head.scene,           "started", head.started,
                                    "rate",    text_of(head.rate), "quantum", text_of(head.quantum)};
  Limits limits = head.limits;
  visit_limits(limits, [&](const char* name, auto& value) { pairs.insert(pairs.end(), {name, text_of(value)}); });
  std::vector<const char*> pointers;
  for (const std::string& text : pairs) pointers.push_back(text.c_str());
  pointers.push_back(nullptr);
  need(recorder_metadata(recorder_, "crumple", pointers.data()));
  for (const auto& car : head.cars)
    need(recorder_attach(recorder_, car->hash.c_str(), car_media_type, car->bytes.data(), car->bytes.size()));
  for (const auto& car : head.given)
    need(recorder_attach(recorder_, car->hash.c_str(), given_media_type, car->bytes.data(), car->bytes.size()));
  if (!head.world.empty()) need(recorder_attach(recorder_, "world", world_media_type, head.world.data(), head.world.size()));
}

Recording::~Recording() { close(); }

std::string Recording::close() {
  if (!recorder_) return {};
  const bool good = recorder_close(recorder_) == 0;
  recorder_ = nullptr;
  return good ? "" : transport_error();
}

// What a full queue refuses is asked for again with the next message.
int Recording::id_of(const std::string& key, Channel channel) {
  if (const auto at = channels_.find(key); at != channels_.end()) return at->second;
  if (channels_.size() >= channel_limit) return -1;
  const char* table = table_of(channel);
  auto schema = schemas_.find(table);
  if (schema == schemas_.end()) {
    const auto length = static_cast<size_t>(message_schema_end - message_schema);
    const int id = recorder_schema(recorder_, table, message_schema, length);
    if (id < 0) return id;
    schema = schemas_.emplace(table, id).first;
  }
  const int id = recorder_channel(recorder_, (root_ + key).c_str(), schema->second);
  if (id >= 0) channels_.emplace(key, id);
  return id;
}

bool Recording::write(const std::string& key, Channel channel, uint64_t tick, uint64_t time_ns, const void* data, size_t size) {
  const int id = id_of(key, channel);
  if (id < 0) {
    ++undeclared_;
    return false;
  }
  return recorder_write(recorder_, id, static_cast<uint32_t>(tick), time_ns, time_ns, data, size) == 0;
}

void Recording::input(uint64_t tick, const Message& message, uint64_t time_ns) {
  const Channel channel = channel_of(message.key);
  if (!is_input(channel)) return;
  lost_inputs_ += !write(message.key, channel, tick, time_ns, message.bytes.data(), message.bytes.size());
}

void Recording::output(uint64_t tick, const Message& message, uint64_t time_ns) {
  const Channel channel = channel_of(message.key);
  if (message.ticket != 0 && channel != Channel::command) return;
  const bool answer = message.ticket != 0;
  write(answer ? message.key + "/answer" : message.key, answer ? Channel::answer : channel, tick, time_ns, message.bytes.data(),
        message.bytes.size());
}

void Recording::end_tick(uint64_t tick, uint64_t hash, uint64_t time_ns) {
  flatbuffers::FlatBufferBuilder builder;
  builder.Finish(schema::CreateTickEnd(builder, tick, hash, lost_inputs_));
  if (write("tick", Channel::tick_end, tick, time_ns, builder.GetBufferPointer(), builder.GetSize())) lost_inputs_ = 0;
}

RecordingReader::RecordingReader(const std::string& path) : path_(path) {
  if (reader_open(path.c_str(), &reader_) < 0) throw std::runtime_error(transport_error());
  try {
    read_metadata();
    const char *name, *type;
    const uint8_t* data;
    size_t size;
    for (uint32_t i = 0; reader_attachment(reader_, i, &name, &type, &data, &size) == 1; ++i) {
      const auto* bytes = reinterpret_cast<const std::byte*>(data);
      if (std::strcmp(type, car_media_type) == 0)
        head_.cars.push_back(read_car({bytes, size}, path + " (recorded by " + head_.program + "): attachment " + name));
      if (std::strcmp(type, given_media_type) == 0) given_[name] = read_car({bytes, size}, path + ": attachment " + name);
      if (std::strcmp(type, world_media_type) == 0) head_.world.assign(bytes, bytes + size);
    }
  } catch (...) {
    reader_close(reader_);
    throw;
  }
}

RecordingReader::~RecordingReader() { reader_close(reader_); }

void RecordingReader::read_metadata() {
  const char* name;
  const char* const* pairs;
  for (uint32_t i = 0; reader_metadata(reader_, i, &name, &pairs) == 1; ++i) {
    if (std::strcmp(name, "crumple") != 0) continue;
    std::map<std::string, std::string> values;
    for (; pairs[0]; pairs += 2) values[pairs[0]] = pairs[1];
    head_.program = values["program"];
    head_.scene = values["scene"];
    head_.started = values["started"];
    bool good = read_number(values["rate"], head_.rate) && read_number(values["quantum"], head_.quantum);
    good &= head_.rate >= 1 && head_.rate <= 1000 && head_.quantum > 0;
    visit_limits(head_.limits, [&](const char* key, auto& value) { good &= read_number(values[key], value); });
    if (!good)
      throw std::runtime_error(path_ + ": its metadata lacks the rate, the quantum or a limit: it was recorded by " +
                               head_.program + ", this is " + program_name + ": use that one");
    root_ = root_of(head_.scene);
    return;
  }
  throw std::runtime_error(path_ + ": has no metadata \"crumple\": it is not a recording of `crumple serve --record`");
}

bool RecordingReader::next(Item& item) {
  ReaderMessage message;
  const int status = reader_next(reader_, &message);
  need(status);
  if (status == 0) return false;
  item.key = message.topic;
  item.channel = Channel::other;
  if (item.key.starts_with(root_)) {
    item.key.remove_prefix(root_.size());
    item.channel = channel_of(item.key);
  }
  item.bytes = {message.data, message.size};
  item.tick = message.sequence;
  item.time_ns = message.log_time_ns;
  if (item.channel == Channel::asset) take_asset(item.bytes);
  return true;
}

// One that the world refused is none here either.
void RecordingReader::take_asset(std::span<const uint8_t> bytes) {
  GivenAsset asset;
  if (decode(std::as_bytes(bytes), head_.limits, asset)) return;
  try {
    const auto car = read_car(asset.car, path_);
    given_[car->hash] = car;
  } catch (const std::runtime_error&) {
  }
}

std::vector<std::shared_ptr<const Car>> RecordingReader::cars() const {
  auto all = head_.cars;
  for (const auto& [hash, car] : given_) all.push_back(car);
  return all;
}

void RecordingReader::rewind() { need(reader_rewind(reader_)); }

}  // namespace crumple
