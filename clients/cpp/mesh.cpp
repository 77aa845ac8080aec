// Makes meshes of baked cars, which the server or the caller gives. It checks a car before it shows a field of it.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include "cpp/session.h"
#include "protocol/asset.h"
#include "protocol/key.h"
#include "schema/car_generated.h"

namespace crumple::client {
namespace {

// Numbers the nodes of the skin in ascending order, as keyframes and deltas do. False: the skin names a node that is missing.
bool read_skin(const schema::Car& car, Asset& asset) {
  const uint32_t none = UINT32_MAX, nodes = car.node()->size();
  const auto weights = [](const schema::Skin& skin) { return std::array{skin.wa(), skin.wb(), skin.wc(), skin.wd()}; };
  const auto corners = [](const schema::Skin& skin) { return std::array{skin.a(), skin.b(), skin.c(), skin.d()}; };
  std::vector<uint32_t> number(nodes, none);
  for (const schema::Skin* skin : *car.skin()) {
    for (size_t k = 0; k < 4; ++k) {
      if (corners(*skin)[k] >= nodes) return false;
      if (weights(*skin)[k] > 0) number[corners(*skin)[k]] = 0;
    }
  }
  asset.skin_nodes = 0;
  for (uint32_t& one : number)
    if (one != none) one = asset.skin_nodes++;
  asset.skin.clear();
  for (const schema::Skin* skin : *car.skin()) {
    SkinVertex vertex{};
    for (size_t k = 0; k < 4; ++k) {
      if (!(weights(*skin)[k] > 0)) continue;
      vertex.at[k] = number[corners(*skin)[k]];
      vertex.weight[k] = weights(*skin)[k];
    }
    asset.skin.push_back(vertex);
  }
  return asset.skin.size() == car.vertex()->size() && asset.skin_nodes > 0;
}

// Reads the parts, and finds the nodes around them. Returns what is wrong, or NULL.
const char* take_parts(const schema::Car& car, Asset& asset) {
  asset.part.clear(), asset.rest.clear(), asset.around.clear();
  if (const char* why = read_parts(car, asset.parts)) return why;
  if (asset.parts.part.empty()) return nullptr;
  std::vector<uint8_t> used(car.node()->size(), 0);
  for (const schema::Skin* skin : *car.skin()) {
    if (skin->wa() > 0) used[skin->a()] = 1;
    if (skin->wb() > 0) used[skin->b()] = 1;
    if (skin->wc() > 0) used[skin->c()] = 1;
    if (skin->wd() > 0) used[skin->d()] = 1;
  }
  for (uint32_t i = 0; i < used.size(); ++i) {
    const schema::Vec3& node = *car.node()->Get(i);
    if (!used[i]) continue;
    if (!std::isfinite(node.x()) || !std::isfinite(node.y()) || !std::isfinite(node.z()))
      return "a node is not a finite number";
    asset.rest.push_back({node.x(), node.y(), node.z()});
  }
  for (const Part& part : asset.parts.part) {
    asset.around.push_back(nodes_around(part, asset.rest));
    CrumplePart& view = asset.part.emplace_back();
    view.name = part.name.c_str();
    view.kind = static_cast<int>(part.kind);
    std::copy(part.position.begin(), part.position.end(), view.position);
    std::copy(part.orientation.begin(), part.orientation.end(), view.orientation);
    view.radius = part.radius;
    view.width = part.width;
  }
  return nullptr;
}

// Sets the pointers of a mesh.
std::string read_mesh(const std::string& hash, Asset& asset) {
  const std::span<const uint8_t> bytes = asset.baked.bytes();
  flatbuffers::Verifier verifier(bytes.data(), bytes.size());
  if (!schema::VerifyCarBuffer(verifier)) return "asset " + hash + " is not a baked car";
  const schema::Car& car = *schema::GetCar(bytes.data());
  const auto& triangle = *car.triangle();
  const uint32_t vertices = car.vertex()->size();
  const bool fits = triangle.size() % 3 == 0 &&
                    std::all_of(triangle.begin(), triangle.end(), [&](uint32_t vertex) { return vertex < vertices; });
  if (!fits || triangle.size() == 0) return "triangles of asset " + hash + " name vertices that it does not have";
  for (const schema::Vec3* v : *car.vertex())
    if (!std::isfinite(v->x()) || !std::isfinite(v->y()) || !std::isfinite(v->z()))
      return "a vertex of asset " + hash + " is not a finite number";
  if (!read_skin(car, asset)) return "the skin of asset " + hash + " names nodes that it does not have";
  if (const char* why = take_parts(car, asset)) return "asset " + hash + " is refused: " + why;
  asset.mesh.vertex_count = vertices;
  asset.mesh.triangle_count = triangle.size() / 3;
  asset.mesh.vertex = reinterpret_cast<const float*>(car.vertex()->Data());
  asset.mesh.triangle = triangle.data();
  asset.mesh.mass = car.mass();
  if (const auto* center = car.center_of_mass()) {
    asset.mesh.center_of_mass[0] = center->x();
    asset.mesh.center_of_mass[1] = center->y();
    asset.mesh.center_of_mass[2] = center->z();
  }
  asset.mesh.name = car.name()->c_str();
  asset.mesh.attribution = car.attribution()->c_str();
  return {};
}

}  // namespace

void take_asset(Crumple& session, AssetNews news) {
  if (!news.whole && news.trouble.empty()) return;
  Asset& asset = session.assets[news.hash];
  asset.trouble = std::move(news.trouble);
  if (!news.whole) return;
  asset.baked = std::move(*news.whole);
  asset.trouble = read_mesh(news.hash, asset);
  asset.whole = asset.trouble.empty();
}

}  // namespace crumple::client

using namespace crumple::client;

int crumple::client::mesh_of(Crumple* session, const char* hash, CrumpleMesh* out) {
  if (!crumple::is_hash(hash)) return fail(CRUMPLE_BAD_ARGUMENT, "asset is not a hash: give 16 hexadecimal digits");
  Asset& asset = session->assets[hash];
  if (asset.whole) {
    *out = asset.mesh;
    return CRUMPLE_OK;
  }
  if (!asset.trouble.empty()) {
    return fail(CRUMPLE_NO_ANSWER, std::exchange(asset.trouble, {}));
  }
  if (!session->net)
    return fail(CRUMPLE_UNKNOWN, "asset " + std::string(hash) + " is not in this session: give it to crumple_add_asset");
  return session->fetching.want(hash, Clock::now()) ? CRUMPLE_PENDING : fail(CRUMPLE_NO_ANSWER, transport_error());
}

int crumple_mesh(Crumple* handle, const char* asset, CrumpleMesh* out) {
  return with(handle, {{"asset", asset}, {"out", out}}, [&](Crumple* session) { return mesh_of(session, asset, out); });
}

int crumple_parts(Crumple* handle, const char* hash, CrumpleParts* out) {
  return with(handle, {{"asset", hash}, {"out", out}}, [&](Crumple* session) -> int {
    CrumpleMesh mesh;
    if (const int status = mesh_of(session, hash, &mesh); status != CRUMPLE_OK) return status;
    const Asset& asset = session->assets.find(std::string_view(hash))->second;
    const auto count = static_cast<uint32_t>(asset.part.size());
    *out = {count, count ? asset.part.data() : nullptr, count ? asset.parts.of_vertex.data() : nullptr};
    return CRUMPLE_OK;
  });
}

int crumple_add_asset(Crumple* handle, const void* car, size_t size, char hash[17]) {
  return with(handle, {{"car", car}, {"hash", hash}}, [&](Crumple* session) -> int {
    if (size > crumple::asset_limit) return fail(CRUMPLE_BAD_ARGUMENT, "the baked car is over 256 MiB");
    Asset asset;
    asset.baked = {std::vector<uint64_t>((size + 7) / 8), size};
    if (size > 0) std::memcpy(asset.baked.words.data(), car, size);
    const std::string name = crumple::hash_of(asset.baked.words.data(), size);
    if (const std::string trouble = read_mesh(name, asset); !trouble.empty()) return fail(CRUMPLE_BAD_ARGUMENT, trouble);
    asset.whole = true;
    Asset& known = session->assets[name];
    session->fetching.forget(name);              // further pieces of it are of no use
    if (!known.whole) known = std::move(asset);  // if a caller has pointers into the other one, they stay valid
    std::memcpy(hash, name.c_str(), 17);
    return CRUMPLE_OK;
  });
}
