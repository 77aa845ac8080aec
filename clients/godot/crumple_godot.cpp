// crumple_client.h for Godot 4.4 or newer: scripts get the class CrumpleSession, the session of a viewer. It uses Godot's C
// interface directly, with the header that Godot writes. If a method fails, Godot shows the library's sentence as an error, and
// the method returns false, 0 or nothing. crumple_car.gd makes a node of this class.
#include <crumple_client.h>
#include <gdextension_interface.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace {

// ---- Godot

#define FROM_GODOT(each)                                                              \
  each(PrintError, print_error);                                                      \
  each(PrintWarning, print_warning);                                                  \
  each(StringNameNewWithLatin1Chars, string_name_new_with_latin1_chars);              \
  each(StringNewWithUtf8CharsAndLen2, string_new_with_utf8_chars_and_len2);           \
  each(StringToUtf8Chars, string_to_utf8_chars);                                      \
  each(PackedByteArrayOperatorIndex, packed_byte_array_operator_index);               \
  each(PackedByteArrayOperatorIndexConst, packed_byte_array_operator_index_const);    \
  each(VariantGetPtrBuiltinMethod, variant_get_ptr_builtin_method);                   \
  each(VariantGetPtrConstructor, variant_get_ptr_constructor);                        \
  each(VariantGetPtrDestructor, variant_get_ptr_destructor);                          \
  each(GetVariantFromTypeConstructor, get_variant_from_type_constructor);             \
  each(GetVariantToTypeConstructor, get_variant_to_type_constructor);                 \
  each(ClassdbConstructObject2, classdb_construct_object2);                           \
  each(ObjectSetInstance, object_set_instance);                                       \
  each(ClassdbRegisterExtensionClass4, classdb_register_extension_class4);            \
  each(ClassdbRegisterExtensionClassMethod, classdb_register_extension_class_method); \
  each(ClassdbUnregisterExtensionClass, classdb_unregister_extension_class);

struct {
#define DECLARE(Type, name) GDExtensionInterface##Type name
  FROM_GODOT(DECLARE)
  GDExtensionPtrBuiltInMethod resize, size;  // of PackedByteArray
} godot;
GDExtensionClassLibraryPtr library;

// This has room for any of the values below.
struct alignas(8) Value {
  unsigned char bytes[16];
};

void destroy(GDExtensionVariantType type, void* value) {
  if (const auto destructor = godot.variant_get_ptr_destructor(type)) destructor(value);
}

struct Name {
  Value value;
  explicit Name(const char* text) { godot.string_name_new_with_latin1_chars(&value, text, false); }
  ~Name() { destroy(GDEXTENSION_VARIANT_TYPE_STRING_NAME, &value); }
  Name(const Name&) = delete;
};

void complain(const std::string& sentence) { godot.print_error(sentence.c_str(), "CrumpleSession", __FILE__, 0, false); }

// Arguments and results of methods, in the layout of Godot's memory.
struct Bytes {
  const void* data;
  size_t size;
};
struct Range {  // a Vector2i
  int32_t first, count;
};
template <class T>
constexpr GDExtensionVariantType type_of() {
  if (std::is_same_v<T, bool>) return GDEXTENSION_VARIANT_TYPE_BOOL;
  if (std::is_same_v<T, int64_t>) return GDEXTENSION_VARIANT_TYPE_INT;
  if (std::is_same_v<T, double>) return GDEXTENSION_VARIANT_TYPE_FLOAT;
  if (std::is_same_v<T, std::string>) return GDEXTENSION_VARIANT_TYPE_STRING;
  if (std::is_same_v<T, Range>) return GDEXTENSION_VARIANT_TYPE_VECTOR2I;
  return GDEXTENSION_VARIANT_TYPE_PACKED_BYTE_ARRAY;
}

template <class T>
T read(const void* value) {
  return *static_cast<const T*>(value);
}
template <>
std::string read(const void* value) {
  std::string text(size_t(godot.string_to_utf8_chars(value, nullptr, 0)), '\0');
  godot.string_to_utf8_chars(value, text.data(), GDExtensionInt(text.size()));
  return text;
}

template <>
Bytes read(const void* value) {
  GDExtensionInt size = 0;
  godot.size(const_cast<void*>(value), nullptr, &size, 0);
  return {size > 0 ? godot.packed_byte_array_operator_index_const(value, 0) : nullptr, size_t(size)};
}

template <class T>
void write(const T& from, void* value) {
  *static_cast<T*>(value) = from;
}
void write(const std::string& from, void* value) {
  destroy(GDEXTENSION_VARIANT_TYPE_STRING, value);
  godot.string_new_with_utf8_chars_and_len2(value, from.data(), GDExtensionInt(from.size()));
}
void write(const Bytes& from, void* value) {
  const auto size = GDExtensionInt(from.size);
  const GDExtensionConstTypePtr arguments[] = {&size};
  GDExtensionInt error = 0;
  godot.resize(value, arguments, &error, 1);
  if (size > 0) std::memcpy(godot.packed_byte_array_operator_index(value, 0), from.data, from.size);
}

// ---- the class

class Session {
 public:
  // Waits for the server of the scene, for at most `seconds`.
  bool open(std::string endpoint, std::string scene, double seconds) {
    const CrumpleOptions options{
        CRUMPLE_CLIENT_VERSION, uint32_t(std::fmax(1, 1e3 * seconds)), endpoint.c_str(), scene.c_str(), nullptr, nullptr};
    Crumple* opened = nullptr;
    if (!good(crumple_open(&options, &opened))) return false;
    crumple_close(handle_);
    handle_ = opened;
    own_.clear();
    return true;
  }
  bool follow(std::string car, int64_t level) { return good(crumple_follow(handle_, car.c_str(), int(level))); }
  // Takes in the messages that have arrived; returns their number.
  int64_t poll() {
    const int messages = crumple_poll(handle_, 0);
    return good(messages) ? messages : 0;
  }
  // The server's time now, s; 0 while the session does not know it.
  double time() { return crumple_time(handle_); }

  // The hash of the car's undamaged mesh; "" while the session holds no surface that is whole and current: keep what you drew.
  std::string asset(std::string car) {
    CrumpleSurface surface;
    return has(crumple_surface(handle_, car.c_str(), &surface)) ? surface.asset : "";
  }
  // Returns false after the car was despawned, or its server has gone.
  bool alive(std::string car) {
    CrumpleSurface surface;
    return !has(crumple_surface(handle_, car.c_str(), &surface)) || surface.alive;
  }

  // These two return the mesh of an asset, or nothing until the asset has come. vertices: Vector3. triangles: int32, clockwise
  // from the front, as Godot has them.
  Bytes vertices(std::string asset) {
    const CrumpleMesh mesh = mesh_of(asset);
    return {mesh.vertex, 12 * size_t{mesh.vertex_count}};
  }
  Bytes triangles(std::string asset) {
    const CrumpleMesh mesh = mesh_of(asset);
    clockwise_.assign(mesh.triangle, mesh.triangle + 3 * size_t{mesh.triangle_count});
    for (size_t i = 0; i < clockwise_.size(); i += 3) std::swap(clockwise_[i + 1], clockwise_[i + 2]);
    return {clockwise_.data(), 4 * clockwise_.size()};
  }
  // Must be shown where the car is shown.
  std::string attribution(std::string asset) {
    const char* text = mesh_of(asset).attribution;
    return text ? text : "";
  }

  // Binds a surface of the game to the baked car, as crumple_map does, and returns the mapping for copy(), or 0. Warns if the
  // surface is far from the baked one. name: of the surface, for the messages. positions, normals: Vector3. tangents: 4 float32
  // for each vertex, the last for the side of the binormal. Normals and tangents may be empty. to_car: the rows of a 3 x 4
  // matrix from the coordinates of the surface to the car's frame, float64.
  int64_t map(std::string asset, std::string name, Bytes positions, Bytes normals, Bytes tangents, Bytes to_car) {
    const size_t count = positions.size / 12;
    const auto fits = [](size_t size, size_t wanted) { return size == 0 || size == wanted; };
    if (count == 0 || !fits(normals.size, 12 * count) || !fits(tangents.size, 16 * count) || to_car.size != 96) {
      complain(name + ": the lists do not fit together: give 3, 3 and 4 float32 for each vertex, and 12 float64");
      return 0;
    }
    const auto* given = static_cast<const float*>(tangents.data);
    std::vector<float> tangent;
    Own own{count, {}};
    for (size_t i = 0; i < tangents.size / 16; ++i) {
      tangent.insert(tangent.end(), given + 4 * i, given + 4 * i + 3);
      own.side.push_back(given[4 * i + 3] < 0 ? -1 : 1);
    }
    CrumpleOwnMesh mesh{};
    mesh.position = static_cast<const float*>(positions.data);
    mesh.normal = static_cast<const float*>(normals.data);
    mesh.tangent = tangent.empty() ? nullptr : tangent.data();
    mesh.stride = 12;
    mesh.count = count;
    mesh.to_car = static_cast<const double*>(to_car.data);
    uint32_t mapping = 0;
    const int status = crumple_map(handle_, asset.c_str(), &mesh, &mapping);
    if (status < 0) complain(name + " shows no dents: " + crumple_error() + "; correct the mesh, or leave it out");
    if (status != CRUMPLE_OK) return 0;
    if (mesh.farthest > far_off) {
      char fact[200];
      std::snprintf(
          fact, sizeof fact,
          ": a vertex is %.2f m away from the baked surface, and %u of %zu vertices lie on vertices of it; move the mesh "
          "to its place in the car, or leave it out",
          double(mesh.farthest), mesh.on_vertices, count);
      godot.print_warning((name + fact).c_str(), "CrumpleSession", __FILE__, 0, false);
    }
    own_.resize(mapping);
    own_.back() = std::move(own);
    return mapping;
  }

  // Decodes the car as it was at that time. mapping: from map(): a surface of the game; 0: the baked surface. Only vertices in
  // this range may differ from the last copy of this car with this mapping; its length is negative while the surface of the car
  // or its mesh is missing.
  Range copy(std::string car, double time, int64_t mapping) {
    CrumpleVertices out{};
    CrumpleMesh mesh{};
    if (const std::string name = asset(car); !name.empty()) mesh = mesh_of(name);
    if (mesh.vertex_count == 0) return {0, -1};
    const Own baked{mesh.vertex_count, {}},
        &own = mapping > 0 && size_t(mapping) <= own_.size() ? own_[size_t(mapping - 1)] : baked;
    const size_t count = own.count;
    position_.resize(3 * count);
    normal_.resize(3 * count);
    side_ = own.side;
    tangent_.resize(3 * side_.size());
    out.position = position_.data();
    out.normal = normal_.data();
    out.tangent = tangent_.empty() ? nullptr : tangent_.data();
    out.stride = 12;
    out.capacity = count;
    out.time = time;
    out.mapping = uint32_t(mapping);
    if (!has(crumple_copy(handle_, car.c_str(), &out))) return {0, -1};
    return {int32_t(out.first), int32_t(out.count)};
  }
  // These two give the last copy as the vertex buffer of a Godot mesh has it: first all positions, then each vertex's normal
  // and tangent, `stride` bytes from one normal to the next. Without tangents their bytes are 0: only a normal map would need
  // them.
  Bytes positions(int64_t first, int64_t count) {
    if (!within(first, count)) return {};
    return {&position_[3 * size_t(first)], 12 * size_t(count)};
  }
  Bytes normals(int64_t first, int64_t count, int64_t stride) {
    if (!within(first, count)) return {};
    folded_.assign(size_t(count * stride / 2), 0);
    for (int64_t i = 0; i < count; ++i) {
      const size_t at = size_t(first + i);
      uint16_t* out = &folded_[size_t(i * stride / 2)];
      fold(&normal_[3 * at], 0, out);
      if (!side_.empty() && stride >= 8) fold(&tangent_[3 * at], side_[at], out + 2);
    }
    return {folded_.data(), 2 * folded_.size()};
  }

  Session() {
    // This one has no network, so that there is always a session.
    const CrumpleOptions none{CRUMPLE_CLIENT_VERSION, 0, nullptr, "main", nullptr, nullptr};
    good(crumple_open(&none, &handle_));
  }
  ~Session() { crumple_close(handle_); }
  Session(const Session&) = delete;

 private:
  static constexpr float far_off = 0.05F;  // m: beyond it a vertex belongs to no part of the baked car

  // A mapped surface of the game. side: of the binormal, 1 or -1 for each vertex; empty: the surface has no tangents.
  struct Own {
    size_t count = 0;  // vertices
    std::vector<float> side;
  };

  static bool good(int status) {
    if (status < 0) complain(crumple_error());
    return status >= 0;
  }
  static bool has(int status) { return good(status) && status == CRUMPLE_OK; }
  CrumpleMesh mesh_of(const std::string& asset) {
    CrumpleMesh mesh{};
    return has(crumple_mesh(handle_, asset.c_str(), &mesh)) ? mesh : CrumpleMesh{};
  }
  bool within(int64_t first, int64_t count) {
    const bool holds = first >= 0 && count > 0 && first + count <= int64_t(position_.size() / 3);
    if (!holds) complain("vertices " + std::to_string(first) + " + " + std::to_string(count) + " are not in the last copy");
    return holds;
  }
  // Puts a direction on the octahedron |x| + |y| + |z| = 1 and folds its lower half over the upper one: 16 bits each for x and
  // y. A tangent has a side, 1 or -1, and y in the upper or the lower half of its 16 bits: Godot tells the side by the half.
  static void fold(const float* direction, float side, uint16_t* out) {
    const float size = std::fabs(direction[0]) + std::fabs(direction[1]) + std::fabs(direction[2]);
    const float x = direction[0] / size, y = direction[1] / size;
    const bool below = direction[2] < 0;
    const float plane[2] = {below ? std::copysign(1 - std::fabs(y), x) : x, below ? std::copysign(1 - std::fabs(x), y) : y};
    for (int i = 0; i < 2; ++i) out[i] = uint16_t(65535 * (0.5F + 0.5F * plane[i]));
    if (side == 0) return;
    out[1] = uint16_t(side > 0 ? 32768 + out[1] / 2 : 32767 - std::max(out[1] / 2, 1));
    if (out[0] == 0 && out[1] == 65535) out[0] = 65535;  // the same direction; (0, 65535) would mark a compressed mesh
  }

  Crumple* handle_ = nullptr;
  std::vector<Own> own_;                                   // mapping k + 1 is own_[k]
  std::vector<float> position_, normal_, tangent_, side_;  // of the last copy
  std::vector<uint32_t> clockwise_;
  std::vector<uint16_t> folded_;
};

// ---- its methods in Godot

constexpr int most_arguments = 6;

struct Method {
  const char* name;
  GDExtensionClassMethodPtrCall run;
  GDExtensionVariantType result;
  uint32_t count;
  GDExtensionVariantType type[most_arguments];
};

template <auto method>
struct Of;
template <class Result, class... Arguments, Result (Session::*method)(Arguments...)>
struct Of<method> {
  template <size_t... i>
  static void run(Session& session, const GDExtensionConstTypePtr* arguments, void* result, std::index_sequence<i...>) {
    (void)arguments;  // for methods without arguments
    write((session.*method)(read<Arguments>(arguments[i])...), result);
  }
  static void run(void*, GDExtensionClassInstancePtr session, const GDExtensionConstTypePtr* arguments, void* result) {
    run(*static_cast<Session*>(session), arguments, result, std::index_sequence_for<Arguments...>());
  }
  static constexpr Method named(const char* name) {
    return {name, run, type_of<Result>(), sizeof...(Arguments), {type_of<Arguments>()...}};
  }
};

const Method methods[] = {
    Of<&Session::open>::named("open"),
    Of<&Session::follow>::named("follow"),
    Of<&Session::poll>::named("poll"),
    Of<&Session::time>::named("time"),
    Of<&Session::asset>::named("asset"),
    Of<&Session::alive>::named("alive"),
    Of<&Session::vertices>::named("vertices"),
    Of<&Session::triangles>::named("triangles"),
    Of<&Session::copy>::named("copy"),
    Of<&Session::attribution>::named("attribution"),
    Of<&Session::positions>::named("positions"),
    Of<&Session::normals>::named("normals"),
    Of<&Session::map>::named("map"),
};

// For a script that does not know the types: converts variants to values and back.
void call(void* userdata, GDExtensionClassInstancePtr session, const GDExtensionConstVariantPtr* arguments,
          GDExtensionInt count, GDExtensionVariantPtr out, GDExtensionCallError* error) {
  const auto& method = *static_cast<const Method*>(userdata);
  if (count != method.count) {
    error->error = count < method.count ? GDEXTENSION_CALL_ERROR_TOO_FEW_ARGUMENTS : GDEXTENSION_CALL_ERROR_TOO_MANY_ARGUMENTS;
    error->expected = int32_t(method.count);
    return;
  }
  Value value[most_arguments], result;
  GDExtensionConstTypePtr pointer[most_arguments];
  for (uint32_t i = 0; i < method.count; ++i) {
    pointer[i] = &value[i];
    godot.get_variant_to_type_constructor(method.type[i])(&value[i], const_cast<GDExtensionVariantPtr>(arguments[i]));
  }
  godot.variant_get_ptr_constructor(method.result, 0)(&result, nullptr);
  method.run(nullptr, session, pointer, &result);
  godot.get_variant_from_type_constructor(method.result)(out, &result);
  destroy(method.result, &result);
  for (uint32_t i = 0; i < method.count; ++i) destroy(method.type[i], &value[i]);
  error->error = GDEXTENSION_CALL_OK;
}

GDExtensionObjectPtr create(void*, GDExtensionBool) {
  const Name base("RefCounted"), name("CrumpleSession");
  const GDExtensionObjectPtr object = godot.classdb_construct_object2(&base.value);
  godot.object_set_instance(object, &name.value, new Session);
  return object;
}

void describe(GDExtensionVariantType type, Name& name, Name& nothing, Value& empty, GDExtensionPropertyInfo& out) {
  out = {type, &name.value, &nothing.value, 0, &empty, 6};  // PROPERTY_USAGE_DEFAULT
}

void begin(void*, GDExtensionInitializationLevel level) {
  if (level != GDEXTENSION_INITIALIZATION_SCENE) return;
  const Name name("CrumpleSession"), base("RefCounted"), resize("resize"), size("size");
  godot.resize = godot.variant_get_ptr_builtin_method(GDEXTENSION_VARIANT_TYPE_PACKED_BYTE_ARRAY, &resize.value, 848867239);
  godot.size = godot.variant_get_ptr_builtin_method(GDEXTENSION_VARIANT_TYPE_PACKED_BYTE_ARRAY, &size.value, 3173160232);
  GDExtensionClassCreationInfo4 info{};
  info.is_exposed = true;
  info.create_instance_func = create;
  info.free_instance_func = [](void*, GDExtensionClassInstancePtr session) { delete static_cast<Session*>(session); };
  godot.classdb_register_extension_class4(library, &name.value, &base.value, &info);

  Name nothing("");
  Value empty;
  godot.variant_get_ptr_constructor(GDEXTENSION_VARIANT_TYPE_STRING, 0)(&empty, nullptr);
  for (const Method& method : methods) {
    Name called(method.name);
    GDExtensionPropertyInfo result, arguments[most_arguments];
    GDExtensionClassMethodArgumentMetadata metadata[most_arguments] = {};
    describe(method.result, nothing, nothing, empty, result);
    for (uint32_t i = 0; i < method.count; ++i) describe(method.type[i], nothing, nothing, empty, arguments[i]);
    GDExtensionClassMethodInfo is{};
    is.name = &called.value;
    is.method_userdata = const_cast<Method*>(&method);
    is.call_func = call;
    is.ptrcall_func = method.run;
    is.method_flags = GDEXTENSION_METHOD_FLAGS_DEFAULT;
    is.has_return_value = true;
    is.return_value_info = &result;
    is.argument_count = method.count;
    is.arguments_info = arguments;
    is.arguments_metadata = metadata;
    godot.classdb_register_extension_class_method(library, &name.value, &is);
  }
  destroy(GDEXTENSION_VARIANT_TYPE_STRING, &empty);
}

void end(void*, GDExtensionInitializationLevel level) {
  if (level != GDEXTENSION_INITIALIZATION_SCENE) return;
  const Name name("CrumpleSession");
  godot.classdb_unregister_extension_class(library, &name.value);
}

}  // namespace

// The entry point that crumple.gdextension names.
extern "C" __attribute__((visibility("default"))) GDExtensionBool crumple_godot(GDExtensionInterfaceGetProcAddress get,
                                                                                GDExtensionClassLibraryPtr itself,
                                                                                GDExtensionInitialization* out) {
  library = itself;
#define FIND(Type, name) \
  if (!(godot.name = reinterpret_cast<GDExtensionInterface##Type>(get(#name)))) return false
  FROM_GODOT(FIND)
  *out = {GDEXTENSION_INITIALIZATION_SCENE, nullptr, begin, end};
  return true;
}
