#include "viewer/fetch.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "protocol/asset.h"
#include "protocol/key.h"

namespace crumple::viewer {
namespace {

bool ask_for_piece(Fetching& all, const std::string& hash, Fetching::Asset& asset, Time now) {
  const uint64_t offset = asset.baked.size;
  const auto* bytes = reinterpret_cast<const uint8_t*>(&offset);
  asset.asked = now;
  asset.asking = all.ask(std::string(asset_root) + hash, {bytes, sizeof offset}, all.patience);
  if (asset.asking) all.tickets[asset.asking] = hash;
  return asset.asking != 0;
}

void append(Baked& baked, std::span<const uint8_t> bytes) {
  baked.words.resize((baked.size + bytes.size() + 7) / 8);
  if (!bytes.empty()) std::memcpy(reinterpret_cast<uint8_t*>(baked.words.data()) + baked.size, bytes.data(), bytes.size());
  baked.size += bytes.size();
}

AssetNews fail(Fetching::Asset& asset, const std::string& hash, std::string why) {
  asset.baked = {};
  return {hash, std::nullopt, std::move(why)};
}

}  // namespace

bool Fetching::want(const std::string& hash, Time now) {
  Asset& asset = assets[hash];
  if (asset.asking || now - asset.asked < ask_again) return true;
  asset.baked = {};
  return ask_for_piece(*this, hash, asset, now);
}

void Fetching::forget(std::string_view hash) {
  const auto at = assets.find(hash);
  if (at == assets.end()) return;
  tickets.erase(at->second.asking);
  assets.erase(at);
}

size_t Fetching::size() const {
  size_t sum = 0;
  for (const auto& [hash, asset] : assets) sum += asset.baked.size;
  return sum;
}

std::optional<AssetNews> Fetching::take_reply(uint64_t ticket, std::span<const uint8_t> bytes, bool failed, Time now) {
  const auto at = tickets.find(ticket);
  if (at == tickets.end()) return std::nullopt;
  const std::string hash = std::move(at->second);
  tickets.erase(at);
  Asset& asset = assets[hash];
  asset.asking = 0;
  if (failed)
    return fail(asset, hash, std::string(reinterpret_cast<const char*>(bytes.data()), std::min<size_t>(bytes.size(), 500)));
  if (asset.baked.size + bytes.size() > asset_limit) return fail(asset, hash, "asset " + hash + " is over 256 MiB");
  append(asset.baked, bytes);
  if (bytes.size() == asset_piece) {
    if (ask_for_piece(*this, hash, asset, now)) return AssetNews{hash};
    return fail(asset, hash, "the next piece of asset " + hash + " cannot be asked for");
  }
  if (const std::string digits = hash_of(asset.baked.words.data(), asset.baked.size); hash != digits) {
    AssetNews news = fail(asset, hash, "the bytes of asset " + hash + " have the hash " + digits + ": ask again");
    news.corrupt = true;
    return news;
  }
  AssetNews news{hash, std::move(asset.baked)};
  assets.erase(hash);
  return news;
}

std::optional<AssetNews> Fetching::end(uint64_t ticket) {
  const auto at = tickets.find(ticket);
  if (at == tickets.end()) return std::nullopt;
  const std::string hash = std::move(at->second);
  tickets.erase(at);
  Asset& asset = assets[hash];
  asset.asking = 0;
  return fail(asset, hash, "the server did not answer with asset " + hash);
}

}  // namespace crumple::viewer
