#include "gateway/assets.h"

#include <cstdio>
#include <utility>

#include "gateway/need.h"

namespace crumple {
namespace {

// Most assets that no living car uses.
constexpr size_t spare_limit = 8;
// Most bytes of all assets (one of 10,000 nodes has 4 MB). With control the gateway holds them twice.
constexpr size_t assets_limit = size_t{1} << 30;

}  // namespace

ShownAssets::ShownAssets(Web* web, viewer::Ask ask, std::function<Hashes()> of_cars, bool keeps)
    : web_(web), of_cars_(std::move(of_cars)), keeps_(keeps), fetching_{std::move(ask)} {}

void ShownAssets::forget_spare() {
  const Hashes of_cars = of_cars_();
  std::map<uint64_t, std::string> spare;
  for (const auto& [hash, asset] : assets_)
    if (!of_cars.contains(hash)) spare[asset.number] = hash;
  for (; spare.size() > spare_limit; spare.erase(spare.begin())) {
    const std::string& oldest = spare.begin()->second;
    assets_.erase(oldest);
    fetching_.forget(oldest);
    need(web_forget(web_, ("/asset/" + oldest).c_str()));
  }
}

ShownAssets::Shown& ShownAssets::find_or_add(const std::string& hash) {
  const auto [at, is_new] = assets_.try_emplace(hash);
  if (is_new) {
    at->second.number = ++wanted_;
    forget_spare();
  }
  return at->second;
}

bool ShownAssets::has_room(size_t more) const {
  more += fetching_.size();
  for (const auto& [hash, asset] : assets_) more += asset.size;
  return more <= assets_limit;
}

void ShownAssets::show(const std::string& hash, Shown& asset, std::span<const uint8_t> bytes) {
  asset.done = true;
  asset.size = bytes.size();
  if (keeps_) asset.bytes = std::make_shared<const std::vector<uint8_t>>(bytes.begin(), bytes.end());
  need(web_page(web_, ("/asset/" + hash).c_str(), "application/octet-stream", bytes.data(), bytes.size()));
}

void ShownAssets::want(const std::string& hash, viewer::Time now) {
  if (!find_or_add(hash).done) fetching_.want(hash, now);
}

void ShownAssets::add_painted(const Car& car) {
  Shown& asset = find_or_add(car.hash);
  if (asset.done || !has_room(car.bytes.size())) return;
  fetching_.forget(car.hash);
  show(car.hash, asset, {reinterpret_cast<const uint8_t*>(car.bytes.data()), car.bytes.size()});
}

ShownAssets::Bytes ShownAssets::bytes(const std::string& hash) const {
  const auto asset = assets_.find(hash);
  return asset == assets_.end() ? nullptr : asset->second.bytes;
}

bool ShownAssets::take_reply(const NetEvent& event, viewer::Time now) {
  const auto news = event.kind == NET_REPLY_END
                        ? fetching_.end(event.ticket)
                        : fetching_.take_reply(event.ticket, {event.data, event.size}, event.failed != 0, now);
  if (!news) return false;
  Shown& asset = assets_[news->hash];
  if (!has_room(news->whole ? news->whole->size : 0)) {
    std::fprintf(stderr, "crumple view: asset %s is not shown: the cars of this scene have more than %zu MiB together\n",
                 news->hash.c_str(), assets_limit >> 20);
    asset.done = true;
    fetching_.forget(news->hash);
  } else if (news->whole) {
    show(news->hash, asset, news->whole->bytes());
  } else if (news->corrupt) {
    std::fprintf(stderr, "crumple view: %s\n", news->trouble.c_str());
  }
  return true;
}

}  // namespace crumple
