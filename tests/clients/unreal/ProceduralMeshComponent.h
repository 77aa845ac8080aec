// The part of Unreal that CrumpleCarComponent uses, with the signatures of its reference manual, so that the sample can be
// compiled and run without Unreal. A mesh keeps its data; nothing is drawn.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#define UCLASS(...)
#define UPROPERTY(...)
#define GENERATED_BODY() using Super = UProceduralMeshComponent;
#define TEXT(text) text
#define UTF8_TO_TCHAR(text) text
#define TCHAR_TO_UTF8(text) text
#define UE_LOG(category, level, ...) logged.push_back(FString::Printf(__VA_ARGS__))

using int32 = std::int32_t;
using uint32 = std::uint32_t;
using TCHAR = char;

struct FString : std::string {
  using std::string::string;
  FString(const std::string& text) : std::string(text) {}
  const TCHAR* operator*() const { return c_str(); }
  template <class... Values>
  static FString Printf(const TCHAR* format, Values... values) {
    char out[1000];
    std::snprintf(out, sizeof out, format, values...);
    return out;
  }
};
inline std::vector<FString> logged;
struct FTCHARToUTF8 {
  const char* text;
  explicit FTCHARToUTF8(const TCHAR* from) : text(from) {}
  const char* Get() const { return text; }
};
struct FMath {
  static float Max(float a, float b) { return std::max(a, b); }
};
template <class T>
struct TArray {
  std::vector<T> all;
  int32 Num() const { return int32(all.size()); }
  void SetNumZeroed(int32 count) { all.assign(size_t(count), T{}); }
  void Empty() { all.clear(); }
  void Add(const T& one) { all.push_back(one); }
  auto begin() { return all.begin(); }
  auto end() { return all.end(); }
  T* GetData() { return all.data(); }
  template <class Index>
  T& operator[](Index at) {
    return all.at(size_t(at));
  }
};
template <class T>
struct TSharedPtr : std::shared_ptr<T> {
  using std::shared_ptr<T>::shared_ptr;
  TSharedPtr(std::shared_ptr<T> from) : std::shared_ptr<T>(from) {}
  bool IsValid() const { return bool(*this); }
  void Reset() { this->reset(); }
};
template <class T>
struct TWeakPtr : std::weak_ptr<T> {
  using std::weak_ptr<T>::weak_ptr;
  TSharedPtr<T> Pin() const { return this->lock(); }
};
template <class T>
TSharedPtr<T> MakeShared() {
  return std::make_shared<T>();
}
template <class Key, class T>
struct TMap : std::map<Key, T> {
  T& FindOrAdd(const Key& key) { return (*this)[key]; }
};

struct FVector {
  double X = 0, Y = 0, Z = 0;
  FVector() = default;
  FVector(double x, double y, double z) : X(x), Y(y), Z(z) {}
  FVector operator-(const FVector& other) const { return {X - other.X, Y - other.Y, Z - other.Z}; }
};
struct FQuat {
  double X, Y, Z, W;
  FQuat(double x, double y, double z, double w) : X(x), Y(y), Z(z), W(w) {}
};
struct FTransform {
  FVector Row[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, Origin;  // not in Unreal, which has a rotation and a scale
  FVector TransformPosition(const FVector& v) const {
    return {v.X * Row[0].X + v.Y * Row[0].Y + v.Z * Row[0].Z + Origin.X,
            v.X * Row[1].X + v.Y * Row[1].Y + v.Z * Row[1].Z + Origin.Y,
            v.X * Row[2].X + v.Y * Row[2].Y + v.Z * Row[2].Z + Origin.Z};
  }
  FString ToString() const {
    FString out;
    for (const FVector& each : {Row[0], Row[1], Row[2], Origin}) out += FString::Printf("%f,%f,%f|", each.X, each.Y, each.Z);
    return out;
  }
};
struct FVector2D {
  double X = 0, Y = 0;
};
struct FColor {};
struct FProcMeshTangent {
  FVector TangentX;
  bool bFlipTangentY = false;
};
struct FObjectInitializer {};
struct FActorComponentTickFunction {
  bool bCanEverTick = false;
};
enum ELevelTick { LEVELTICK_All };
namespace EEndPlayReason {
enum Type { Destroyed };
}

struct UMaterialInterface {};

class UProceduralMeshComponent {
 public:
  explicit UProceduralMeshComponent(const FObjectInitializer&) {}
  virtual ~UProceduralMeshComponent() = default;
  virtual void BeginPlay() {}
  virtual void EndPlay(const EEndPlayReason::Type) {}
  virtual void TickComponent(float, ELevelTick, FActorComponentTickFunction*) {}
  void CreateMeshSection(int32 Section, const TArray<FVector>& Vertices, const TArray<int32>& Triangles,
                         const TArray<FVector>& Normals, const TArray<FVector2D>& UVs, const TArray<FColor>&,
                         const TArray<FProcMeshTangent>& Tangents, bool) {
    section[Section] = {Vertices, Normals, Triangles, UVs, Tangents};
  }
  void UpdateMeshSection(int32 Section, const TArray<FVector>& Vertices, const TArray<FVector>& Normals,
                         const TArray<FVector2D>& UVs, const TArray<FColor>&, const TArray<FProcMeshTangent>& Tangents) {
    Drawn& drawn = section.at(Section);
    drawn.vertices = Vertices, drawn.normals = Normals;
    if (UVs.Num() > 0) drawn.uvs = UVs;
    if (Tangents.Num() > 0) drawn.tangents = Tangents;
    ++updates;
  }
  UMaterialInterface* GetMaterial(int32 index) const { return material.contains(index) ? material.at(index) : nullptr; }
  void SetMaterial(int32 index, UMaterialInterface* one) { material[index] = one; }
  FTransform GetRelativeTransform() const { return place; }
  FActorComponentTickFunction PrimaryComponentTick;
  // Not in Unreal: the data of the graphics card.
  struct Drawn {
    TArray<FVector> vertices, normals;
    TArray<int32> corners;
    TArray<FVector2D> uvs;
    TArray<FProcMeshTangent> tangents;
  };
  std::map<int32, Drawn> section;
  std::map<int32, UMaterialInterface*> material;
  FTransform place;
  int updates = 0;
};
