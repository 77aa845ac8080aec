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
#define UE_LOG(category, level, format, ...) std::fprintf(stderr, format "\n", __VA_ARGS__)

using int32 = std::int32_t;
using uint32 = std::uint32_t;
using TCHAR = char;

struct FString : std::string {
  using std::string::string;
  FString(const std::string& text) : std::string(text) {}
  const TCHAR* operator*() const { return c_str(); }
};
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
  T* GetData() { return all.data(); }
  T& operator[](size_t at) { return all.at(at); }
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
};
struct FQuat {
  double X, Y, Z, W;
  FQuat(double x, double y, double z, double w) : X(x), Y(y), Z(z), W(w) {}
};
struct FVector2D {};
struct FColor {};
struct FProcMeshTangent {};
struct FObjectInitializer {};
struct FActorComponentTickFunction {
  bool bCanEverTick = false;
};
enum ELevelTick { LEVELTICK_All };
namespace EEndPlayReason {
enum Type { Destroyed };
}

class UProceduralMeshComponent {
 public:
  explicit UProceduralMeshComponent(const FObjectInitializer&) {}
  virtual ~UProceduralMeshComponent() = default;
  virtual void BeginPlay() {}
  virtual void EndPlay(const EEndPlayReason::Type) {}
  virtual void TickComponent(float, ELevelTick, FActorComponentTickFunction*) {}
  void CreateMeshSection(int32, const TArray<FVector>& Vertices, const TArray<int32>& Triangles, const TArray<FVector>& Normals,
                         const TArray<FVector2D>&, const TArray<FColor>&, const TArray<FProcMeshTangent>&, bool) {
    drawn = Vertices, normals = Normals, corners = Triangles;
  }
  void UpdateMeshSection(int32, const TArray<FVector>& Vertices, const TArray<FVector>& Normals, const TArray<FVector2D>&,
                         const TArray<FColor>&, const TArray<FProcMeshTangent>&) {
    drawn = Vertices, normals = Normals;
    ++updates;
  }
  FActorComponentTickFunction PrimaryComponentTick;
  TArray<FVector> drawn, normals;  // not in Unreal: the data of the graphics card
  TArray<int32> corners;
  int updates = 0;
};
