// Requests of browsers that may command. The gateway passes commands to the scene's server unchanged, and paints cars itself.
//   POST /command/car/{car}   Command                          answer: the server's Answer
//   POST /paint/{hash}        schema/regions.fbs as JSON       answer: the baked car, which the server has received too
// A refusal has a status of 4xx or 5xx and a sentence.
#pragma once

#include <functional>
#include <future>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "car/car.h"
#include "io/net.h"
#include "io/web.h"

namespace crumple {

// The parameters of a car with ranges, units and defaults, as JSON. control: whether the page may set them.
std::string parameters_json(bool control);

class Control {
 public:
  using Bytes = std::shared_ptr<const std::vector<uint8_t>>;
  // shown: returns the bytes of an asset; null: none. painted: receives an asset that the scene's server has accepted.
  using Shown = std::function<Bytes(const std::string& hash)>;
  using Painted = std::function<void(const crumple::Car&)>;
  Control(Net*, Web*, std::string root, Shown, Painted);
  // Takes requests from browsers, and answers those that are done.
  void work();
  // Whether the event belonged to a question of this object.
  bool take_reply(const NetEvent&);

 private:
  using Car = std::shared_ptr<const crumple::Car>;
  struct Passed {
    uint64_t ticket;
    Car car;  // the uploaded car; null: a command
  };
  void take(const WebRequest&);
  void command(const WebRequest&, const std::string& car);
  void upload(uint64_t ticket, const Car&);
  void pass(const Passed&, const std::string& key, std::span<const uint8_t>);
  void refuse(uint64_t ticket, uint16_t status, const std::string& sentence);

  Net* net_;
  Web* web_;
  std::string root_;
  Shown shown_;
  Painted painted_;
  std::optional<std::pair<uint64_t, std::future<Car>>> painting_;  // ticket of the request, and its result; one at a time
  std::map<uint64_t, Passed> passed_;                              // by ticket of net_get
};

}  // namespace crumple
