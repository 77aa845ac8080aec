#include "recording/recording.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <charconv>
#include <cstring>
#include <stdexcept>

#include "wire/decode.h"
#include "wire/encode.h"

// The file contains the schema of all messages, so any MCAP tool can read a recording without other files.
asm(".pushsection .rodata\n.balign 8\nmessage_schema:\n.incbin \"" CRUMPLE_MESSAGE_BFBS "\"\nmessage_schema_end:\n.popsection");
extern "C" const uint8_t message_schema[], message_schema_end[];

namespace crumple {

const char* const program_name = "crumple 0.1.0+" CRUMPLE_PHYSICS;

namespace {

constexpr const char* head_name = "crumple";
constexpr const char* counted = "counted";  // value of "end" in the head
// A reader accepts records up to 256 MiB, and the world of many damaged cars is larger.
constexpr size_t world_piece = size_t{64} << 20;

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
std::string text_of(Number value) {  // shortest text that reads back as the same bits
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

std::string recorded_key(const Message& message) {
  if (message.ticket == 0) return message.key;
  return channel_of(message.key) == Channel::command ? message.key + "/answer" : "";
}

uint64_t hash_of_input(std::string_view key, const void* data, size_t size) {
  return XXH3_64bits_withSeed(data, size, XXH3_64bits(key.data(), key.size()));
}

RecordingEnd end_of(Reader* reader) {
  RecordingEnd end;
  const char* name;
  const char* const* pairs;
  for (uint32_t i = 0; reader_metadata(reader, i, &name, &pairs) == 1; ++i) {
    std::map<std::string, std::string> values;
    for (; pairs[0]; pairs += 2) values[pairs[0]] = pairs[1];
    if (std::strcmp(name, head_name) == 0) end.expected = values["end"] == counted;
    if (std::strcmp(name, end_name) != 0) continue;
    end.there = read_number(values["ticks"], end.ticks) && read_number(values["messages"], end.messages);
    end.recovered = values["recovered"] == "yes";
  }
  return end;
}

std::string trouble_at_end(const RecordingEnd& end, uint64_t ticks, uint64_t messages) {
  if (!end.there && end.expected)
    return "it lacks its end, which says how many ticks were recorded: it was cut off, and another program closed it; "
           "`crumple recover` makes a whole recording of the rest";
  if (!end.there || (ticks >= end.ticks && messages >= end.messages)) return "";
  return std::to_string(end.ticks) + " ticks and " + std::to_string(end.messages) +
         " messages were recorded, but the file has only " + std::to_string(ticks) + " and " + std::to_string(messages) +
         ": a program removed the others";
}

void write_end(Recorder* recorder, const RecordingEnd& end) {
  const std::string ticks = text_of(end.ticks), messages = text_of(end.messages);
  const char* const pairs[] = {"ticks", ticks.c_str(), "messages", messages.c_str(), "recovered", end.recovered ? "yes" : "no",
                               nullptr};
  when_there_is_room([&] { return recorder_metadata(recorder, end_name, pairs); });
}

RecorderHandle open_recorder(const std::string& path) {
  Recorder* recorder = nullptr;
  need(recorder_open(path.c_str(), "crumple", program_name, &recorder));
  return RecorderHandle(recorder);
}

Recording::Recording(RecorderHandle recorder, const RecordingHead& head, const RecordingBounds& bounds)
    : recorder_(std::move(recorder)), root_(root_of(head.scene)), bounds_(bounds) {
  write_head(head);
}

void Recording::write_head(const RecordingHead& head) {
  std::vector<std::string> pairs = {"program", head.program,          "scene", head.scene,
                                    "started", head.started,          "rate",  text_of(head.rate),
                                    "quantum", text_of(head.quantum), "end",   counted};
  Limits limits = head.limits;
  visit_limits(limits, [&](const char* name, auto& value) { pairs.insert(pairs.end(), {name, text_of(value)}); });
  std::vector<const char*> pointers;
  for (const std::string& text : pairs) pointers.push_back(text.c_str());
  pointers.push_back(nullptr);
  need(recorder_metadata(recorder_.get(), head_name, pointers.data()));
  for (const auto& car : head.cars)
    need(recorder_attach(recorder_.get(), car->hash.c_str(), car_media_type, car->bytes.data(), car->bytes.size()));
  for (const auto& car : head.uploaded)
    need(recorder_attach(recorder_.get(), car->hash.c_str(), uploaded_media_type, car->bytes.data(), car->bytes.size()));
  for (std::span<const std::byte> rest(head.world); !rest.empty();) {
    const auto piece = rest.first(std::min(rest.size(), world_piece));
    need(recorder_attach(recorder_.get(), "world", world_media_type, piece.data(), piece.size()));
    rest = rest.subspan(piece.size());
  }
}

Recording::~Recording() { close(); }

std::string Recording::close() {
  if (!recorder_) return {};
  write_end(recorder_.get(), end_);
  const bool good = recorder_close(recorder_.release()) == 0;
  return good ? "" : transport_error();
}

bool Recording::full() const {
  return channels_.size() >= bounds_.next_channels || recorder_index(recorder_.get()) >= bounds_.next_index ||
         bytes_ >= bounds_.next_bytes;
}

int Recording::refuse(const std::string& why) {
  if (why_lost_.empty()) why_lost_ = why;
  return TRANSPORT_DROPPED;
}

// If the queue is full, the channel is declared with the next message instead.
int Recording::id_of(const std::string& key, Channel channel) {
  if (const auto at = channels_.find(key); at != channels_.end()) return at->second;
  if (channels_.size() >= bounds_.most_channels)
    return refuse("cars and hosts have used more than " + std::to_string(bounds_.most_channels) +
                  " keys, and the server could not begin the next file; give new cars and hosts the ids of old ones");
  const char* table = table_of(channel);
  auto schema = schemas_.find(table);
  if (schema == schemas_.end()) {
    const auto length = static_cast<size_t>(message_schema_end - message_schema);
    const int id = recorder_schema(recorder_.get(), table, message_schema, length);
    if (id < 0) return refuse(transport_error());
    schema = schemas_.emplace(table, id).first;
  }
  const int id = recorder_channel(recorder_.get(), (root_ + key).c_str(), schema->second);
  if (id < 0) return refuse(transport_error());
  return channels_.emplace(key, id).first->second;
}

bool Recording::write(const std::string& key, Channel channel, uint64_t tick, uint64_t time_ns, const void* data, size_t size) {
  int id = TRANSPORT_DROPPED;
  if (recorder_index(recorder_.get()) < bounds_.most_index)
    id = id_of(key, channel);
  else
    refuse("its index takes " + std::to_string(bounds_.most_index >> 20) +
           " MiB of memory, and the server could not begin the next file; give --record a folder where it can make files");
  if (id < 0) {
    ++refused_;
    return false;
  }
  if (recorder_write(recorder_.get(), id, static_cast<uint32_t>(tick), time_ns, time_ns, data, size) < 0) {
    refuse(transport_error());
    return false;
  }
  ++end_.messages;
  bytes_ += size;
  return true;
}

void Recording::input(uint64_t tick, const Message& message, uint64_t time_ns) {
  const Channel channel = channel_of(message.key);
  if (!is_input(channel)) return;
  inputs_ += hash_of_input(message.key, message.bytes.data(), message.bytes.size());
  lost_inputs_ += !write(message.key, channel, tick, time_ns, message.bytes.data(), message.bytes.size());
}

void Recording::output(uint64_t tick, const Message& message, uint64_t time_ns) {
  const std::string key = recorded_key(message);
  if (key.empty()) return;
  const Channel channel = channel_of(key);
  const bool written = write(key, channel, tick, time_ns, message.bytes.data(), message.bytes.size());
  lost_outputs_ += !written && channel != Channel::health;  // no tick produces health
}

void Recording::end_tick(uint64_t tick, uint64_t hash, uint64_t time_ns) {
  const Bytes end = encode_tick_end({tick, hash, lost_inputs_, lost_outputs_, inputs_});
  if (!write("tick", Channel::tick_end, tick, time_ns, end.data(), end.size())) return;
  lost_inputs_ = lost_outputs_ = inputs_ = 0;
  ++end_.ticks;
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
      if (std::strcmp(type, uploaded_media_type) == 0) given_[name] = read_car({bytes, size}, path + ": attachment " + name);
      if (std::strcmp(type, world_media_type) == 0) head_.world.insert(head_.world.end(), bytes, bytes + size);
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
    if (std::strcmp(name, head_name) != 0) continue;
    std::map<std::string, std::string> values;
    for (; pairs[0]; pairs += 2) values[pairs[0]] = pairs[1];
    head_.program = values["program"];
    head_.scene = values["scene"];
    head_.started = values["started"];
    bool good = read_number(values["rate"], head_.rate) && read_number(values["quantum"], head_.quantum);
    good &= head_.rate >= 1 && head_.rate <= 1000 && head_.quantum > 0;
    visit_limits(head_.limits, [&](const char* key, auto& value) { good &= read_number(values[key], value); });
    good &= is_scene(head_.scene);
    if (!good)
      throw std::runtime_error(path_ + ": its metadata lacks the scene, the rate, the quantum or a limit; " + head_.program +
                               " recorded it, and this is " + program_name + ": use the program that recorded it");
    root_ = root_of(head_.scene);
    return;
  }
  const char* type;
  const uint8_t* bytes;
  size_t size;
  if (reader_metadata(reader_, 0, &name, &pairs) != 1 && reader_attachment(reader_, 0, &name, &type, &bytes, &size) != 1)
    throw std::runtime_error(
        path_ + ": the file is empty, because its server was killed before it recorded, perhaps as a standby; delete the file");
  throw std::runtime_error(path_ + ": the file has no metadata \"crumple\": it is not a recording of `crumple serve --record`");
}

bool RecordingReader::next(Item& item) {
  ReaderMessage message;
  const int status = reader_next(reader_, &message);
  need(status);
  if (status == 0) return false;
  item.key = message.topic;
  Key key;
  if (item.key.starts_with(root_)) {
    item.key.remove_prefix(root_.size());
    key = parse_key(item.key).value_or(Key{});
  }
  item.channel = key.channel;
  item.level = key.number;
  item.bytes = {message.data, message.size};
  item.tick = message.sequence;
  item.time_ns = message.log_time_ns;
  if (item.channel == Channel::asset) take_asset(item.bytes);
  return true;
}

// An asset that the world refused is left out here too.
void RecordingReader::take_asset(std::span<const uint8_t> bytes) {
  UploadedAsset asset;
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
