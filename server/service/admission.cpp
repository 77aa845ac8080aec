#include "service/admission.h"

#include <algorithm>
#include <array>
#include <iterator>
#include <stdexcept>

#include "tick/uploads.h"

namespace crumple {
namespace {

// Bytes of one sample. Between two ticks the transport keeps only the newest poses and the newest obstacles of each host. Poses
// of 1,000 cars have 200 kB.
constexpr size_t sample_limit = size_t{1} << 20;
// What a tick takes of each line. A command may copy a whole body (spawn, save, load): some ms at 50,000 nodes. A keyframe is
// copied and compressed: some 20 us. A piece of a baked car is a copy of 256 KiB. A tick takes only one uploaded car, whose
// check takes as long as 16 commands at a tenth of the nodes, and one query for the last inputs of all hosts, which may have 16
// MiB.
constexpr std::array<int, line_count> taken_per_tick = {16, 128, 4};
constexpr size_t long_asset = size_t{64} << 10;          // bytes; anything shorter is no car, and is refused quickly
constexpr size_t query_bytes_limit = size_t{256} << 20;  // of all waiting queries: four of the longest
constexpr size_t command_limit = size_t{32} << 20;       // bytes: a load command with the state of a car of 100,000 nodes
// Samples a second of unknown hosts. A publisher may invent hosts, and each takes two channels of the recording, which may have
// 60,000 in the 10 s that a file lasts at least. The 64 hosts of a scene need 128.
constexpr size_t newcomers_limit = 2'048;

void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

Line line_of(Channel channel) {
  if (channel == Channel::command || channel == Channel::asset) return Line::commands;
  return channel == Channel::keyframe ? Line::keyframes : Line::reads;
}

std::span<const std::byte> bytes_of(const NetEvent& event) {
  return {reinterpret_cast<const std::byte*>(event.data), event.size};
}

}  // namespace

void Admission::open(Net* net, const World& world) {
  for (const char* what : {"host/*/poses", "host/*/obstacles"})
    need(net_subscribe_newest(net, (root_ + what).c_str(), sample_limit, has_later_sequence));
  need(net_queryable(net, (root_ + "asset").c_str(), query_limit, largest_upload + question_limit));
  need(net_queryable(net, (root_ + "car/*").c_str(), query_limit, command_limit));
  for (const char* what : {"car/*/key/*", "replica/world", "inputs"})
    need(net_queryable(net, (root_ + what).c_str(), query_limit, question_limit));
  need(net_queryable(net, (std::string(asset_root) + "*").c_str(), query_limit, question_limit));
  forget_hosts(net, world);  // a server that takes over knows the hosts of the previous owner
}

void Admission::refuse_query(Net* net, uint64_t ticket, const std::string& sentence) {
  ++queries_refused_;
  net_reply(net, ticket, sentence.data(), sentence.size(), 1);
}

void Admission::take_query(Net* net, const NetEvent& event, const Key& key) {
  constexpr std::array asked = {Channel::asset,  Channel::command, Channel::keyframe,
                                Channel::latest, Channel::world,   Channel::piece};
  if (std::find(asked.begin(), asked.end(), key.channel) == asked.end()) {
    ++keys_refused_;
    return refuse_query(net, event.ticket,
                        "the server answers no query with the key " + printable(event.key) +
                            ": schema/README.md lists the keys; an id has " + id_rule);
  }
  std::deque<Query>& line = lines_[size_t(line_of(key.channel))];
  if (line.size() >= query_limit || queries_bytes_ + event.size > query_bytes_limit)
    return refuse_query(net, event.ticket, "too many questions wait here: ask again later");
  const auto bytes = bytes_of(event);
  const std::string_view below = key.channel == Channel::piece ? "" : std::string_view(event.key).substr(root_.size());
  queries_bytes_ += event.size;
  line.push_back({key.channel, std::string(key.id), {std::string(below), {bytes.begin(), bytes.end()}, event.ticket}});
}

void Admission::take_sample(const NetEvent& event, const Key& key) {
  const bool known = std::binary_search(known_.begin(), known_.end(), key.id);
  if ((key.channel != Channel::poses && key.channel != Channel::obstacles) || (!known && ++newcomers_ > newcomers_limit)) {
    ++keys_refused_;
    return;
  }
  const auto bytes = bytes_of(event);
  samples_.push_back({event.key + root_.size(), {bytes.begin(), bytes.end()}});
}

void Admission::take(Net* net, const NetEvent& event, const Key& key) {
  if (event.kind == NET_QUERY) return take_query(net, event, key);
  if (event.kind == NET_SAMPLE) return take_sample(event, key);
}

std::vector<std::shared_ptr<const Car>> Admission::all_cars(const World& world) const {
  auto cars = uploaded_cars(world);
  cars.insert(cars.end(), cars_.begin(), cars_.end());
  return cars;
}

size_t Admission::waiting() const {
  size_t sum = 0;
  for (const auto& line : lines_) sum += line.size();
  return sum;
}

// Queries come before samples, and commands before keyframes: a host may spawn a car, move it and ask for it at once.
Inbox Admission::admit(Net* net, const World& world) {
  Inbox inbox;
  for (size_t k = 0; k < line_count; ++k) {
    std::deque<Query>& line = lines_[k];
    for (int left = taken_per_tick[k]; !line.empty(); line.pop_front()) {
      auto& [channel, hash, next] = line.front();
      const bool long_one = channel == Channel::latest || (channel == Channel::asset && next.bytes.size() > long_asset);
      left -= long_one ? taken_per_tick[k] : 1;
      if (left < 0) break;
      queries_bytes_ -= next.bytes.size();
      const auto* bytes = reinterpret_cast<const uint8_t*>(next.bytes.data());
      const NetEvent query{NET_QUERY, 0, next.key.c_str(), bytes, next.bytes.size(), next.ticket};
      if (channel == Channel::latest)
        latest_.answer(net, next.ticket);
      else if (channel == Channel::world)
        world_answers_.answer(net, query, world);
      else if (channel == Channel::piece)
        answer_asset(net, query, hash, all_cars(world));
      else
        inbox.push_back(std::move(next));
    }
  }
  std::move(samples_.begin(), samples_.end(), std::back_inserter(inbox));
  samples_.clear();
  return inbox;
}

void Admission::keep_latest(const TickResult& result, const Inbox& inbox) {
  for (const size_t k : result.latest) latest_.keep(inbox[k]);
}

void Admission::forget_hosts(Net* net, const World& world) {
  std::vector<std::string> now = hosts(world);
  for (const std::string& host : known_)
    if (!std::binary_search(now.begin(), now.end(), host)) net_withdraw(net, (root_ + "host/" + host + "/").c_str());
  latest_.forget_others(now);
  std::string keys;  // of the known hosts: a flood of messages from others must not hide theirs
  for (const std::string& host : now)
    for (const char* what : {"/poses", "/obstacles"}) keys += (keys.empty() ? "" : ",") + root_ + "host/" + host + what;
  need(net_prefer(net, keys.c_str()));
  known_ = std::move(now);
  newcomers_ = 0;
}

}  // namespace crumple
