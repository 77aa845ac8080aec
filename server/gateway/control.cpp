#include "gateway/control.h"

#include <chrono>
#include <cstdio>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "bake/bake.h"
#include "protocol/key.h"
#include "schema/message_generated.h"
#include "sim/material.h"

namespace crumple {
namespace {

constexpr uint32_t answer_ms = 5'000;
constexpr std::string_view command_path = "/command/car/", paint_path = "/paint/";

std::shared_ptr<const Car> paint(const Control::Bytes& bytes, const std::string& hash, std::string regions) {
  BakeOptions options;
  options.input = "car " + hash;
  options.regions = {"the regions", std::move(regions)};
  return rebake(*read_car(std::as_bytes(std::span(*bytes)), options.input), options).car;
}

}  // namespace

std::string parameters_json(bool control) {
  std::string json = std::string("{\"control\":") + (control ? "true" : "false") + ",\"parameters\":[";
  for (const Range& range : parameter_ranges()) {
    const std::string_view unit = range.unit;
    char text[400];
    std::snprintf(text, sizeof text,
                  "%s{\"name\":\"%s\",\"low\":%g,\"high\":%g,\"standard\":%g,\"unit\":\"%s\",\"ofRegion\":%s,\"whole\":%s}",
                  json.back() == '[' ? "" : ",", range.name, double(range.low), double(range.high),
                  double(range.value(Parameters{}, 0)), unit.empty() ? "" : range.unit + 1, range.of_region ? "true" : "false",
                  range.whole ? "true" : "false");
    json += text;
  }
  return json + "]}\n";
}

Control::Control(Net* net, Web* web, std::string root, Shown shown, Painted painted)
    : net_(net), web_(web), root_(std::move(root)), shown_(std::move(shown)), painted_(std::move(painted)) {
  if (web_take_requests(web_) < 0) throw std::runtime_error(transport_error());
}

void Control::refuse(uint64_t ticket, uint16_t status, const std::string& sentence) {
  web_answer(web_, ticket, status, "text/plain; charset=utf-8", sentence.data(), sentence.size());
}

void Control::pass(const Passed& passed, const std::string& key, std::span<const uint8_t> bytes) {
  uint64_t asked = 0;
  if (net_get(net_, (root_ + key).c_str(), bytes.data(), bytes.size(), answer_ms, &asked) == 0)
    passed_[asked] = passed;
  else
    refuse(passed.ticket, 502, transport_error());
}

void Control::command(const WebRequest& request, const std::string& car) {
  if (!is_id(car)) return refuse(request.ticket, 400, std::string("this is not the id of a car: an id has ") + id_rule);
  pass({request.ticket, nullptr}, "car/" + car, {request.data, request.size});
}

void Control::upload(uint64_t ticket, const Car& car) {
  flatbuffers::FlatBufferBuilder builder;
  const auto bytes = builder.CreateVector(reinterpret_cast<const uint8_t*>(car->bytes.data()), car->bytes.size());
  builder.Finish(schema::CreateAsset(builder, bytes));
  pass({ticket, car}, "asset", {builder.GetBufferPointer(), builder.GetSize()});
}

void Control::take(const WebRequest& request) {
  const std::string_view path = request.path;
  if (path.starts_with(command_path)) return command(request, std::string(path.substr(command_path.size())));
  if (!path.starts_with(paint_path))
    return refuse(request.ticket, 404,
                  "nothing is at this path: send commands to /command/car/{car}, and paint to /paint/{hash}");
  const std::string hash(path.substr(paint_path.size()));
  const Bytes car = shown_(hash);
  if (!car) return refuse(request.ticket, 404, "no car of this scene has this asset");
  std::string regions(reinterpret_cast<const char*>(request.data), request.size);
  painting_.emplace(request.ticket, std::async(std::launch::async, paint, car, hash, std::move(regions)));
}

// Paints one car at a time. Later requests wait in io, which forgets those whose browser disconnects.
void Control::work() {
  for (WebRequest request; !painting_ && web_next(web_, &request) == 1;) take(request);
  if (!painting_ || painting_->second.wait_for(std::chrono::seconds(0)) != std::future_status::ready) return;
  const uint64_t ticket = painting_->first;
  try {
    upload(ticket, painting_->second.get());
  } catch (const std::exception& error) {
    refuse(ticket, 422, error.what());
  }
  painting_.reset();
}

bool Control::take_reply(const NetEvent& event) {
  const auto found = passed_.find(event.ticket);
  if (found == passed_.end()) return false;
  const auto [ticket, car] = found->second;
  passed_.erase(found);
  flatbuffers::Verifier verifier(event.data, event.size);
  if (event.kind == NET_REPLY_END || event.size == 0 || !verifier.VerifyBuffer<schema::Answer>(nullptr)) {
    refuse(ticket, 504, "the scene's server did not answer");
  } else if (!car) {
    web_answer(web_, ticket, 200, "application/octet-stream", event.data, event.size);
  } else if (const auto* answer = flatbuffers::GetRoot<schema::Answer>(event.data); answer->ok()) {
    painted_(*car);
    web_answer(web_, ticket, 200, "application/octet-stream", car->bytes.data(), car->bytes.size());
  } else {
    refuse(ticket, 409, answer->sentence() ? answer->sentence()->str() : "the scene's server refused the car");
  }
  return true;
}

}  // namespace crumple
