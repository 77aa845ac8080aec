// Admits network messages to the tick. Each key from the network is parsed here, once; unknown keys are refused and counted.
// Queries wait in a queue. Each tick takes only as many as it has time for, so no sender can make a tick long.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "io/net.h"
#include "protocol/key.h"
#include "recording/answer.h"
#include "service/standby.h"
#include "tick/world.h"

namespace crumple {

// Most queries that may wait in each line. Further ones are refused.
inline constexpr uint32_t query_limit = 1'000;
// Queries wait in three lines, so that one kind cannot hold up another: viewers may not command, and ask for a lot.
enum class Line : uint8_t { commands, keyframes, reads };
inline constexpr size_t line_count = 3;

class Admission {
 public:
  Admission(std::string root, const std::vector<std::shared_ptr<const Car>>& cars) : root_(std::move(root)), cars_(cars) {}

  // Subscribes to the hosts' messages and starts answering queries. Throws std::runtime_error.
  void open(Net*, const World&);
  // Queues a query or a host's sample. Ignores other events. A tick gets the events of one poll, in which each key has at most
  // one sample.
  void take(Net*, const NetEvent&, const Key&);
  // Returns the inputs of the next tick: the waiting queries that it has time for, then the samples. Answers the queries that
  // need no tick.
  Inbox admit(Net*, const World&);
  // Keeps the messages that the tick took from this inbox, for viewers that come late.
  void keep_latest(const TickResult&, const Inbox&);
  // Call it once a second. Forgets hosts that have nothing in the scene any more: their latest messages, and the keys on which
  // the server published to them.
  void forget_hosts(Net*, const World&);

  const LatestInputs& latest() const { return latest_; }
  size_t waiting() const;  // queries, in all lines
  uint64_t keys_refused() const { return keys_refused_; }
  uint64_t queries_refused() const { return queries_refused_; }

 private:
  // A waiting query: its channel, its message, and the asset's hash if it asks for a piece of an asset.
  struct Query {
    Channel channel;
    std::string hash;
    Message message;
  };
  void refuse_query(Net*, uint64_t ticket, const std::string& sentence);
  void take_query(Net*, const NetEvent&, const Key&);
  void take_sample(const NetEvent&, const Key&);
  std::vector<std::shared_ptr<const Car>> all_cars(const World&) const;

  std::string root_;  // "crumple/1/{scene}/"
  const std::vector<std::shared_ptr<const Car>>& cars_;
  std::vector<std::string> known_;  // ids of the hosts that had something in the scene a second ago
  size_t newcomers_ = 0;            // samples of all other hosts in this second
  std::array<std::deque<Query>, line_count> lines_;
  size_t queries_bytes_ = 0;
  uint64_t queries_refused_ = 0, keys_refused_ = 0;
  Inbox samples_;
  LatestInputs latest_;
  WorldAnswers world_answers_;
};

}  // namespace crumple
