// Shows a car of a scene in Unreal Engine 5 as it dents. Attach it to the component that the game moves as the car. Nobody has
// run it in Unreal yet: README.md says what was tested.
#pragma once

#include <Engine/StaticMesh.h>
#include <ProceduralMeshComponent.h>
#include <crumple_client.h>
// clang-format off
#include "CrumpleCarComponent.generated.h"  // Unreal wants it last
// clang-format on

// Converts between our axes (right-handed; a car has x forward, y left, z up; m) and Unreal's (left-handed; x forward, y right,
// z up; cm).
namespace CrumpleAxes {
inline FVector PointToUnreal(const float* Ours) { return FVector(100.0 * Ours[0], -100.0 * Ours[1], 100.0 * Ours[2]); }
inline FVector DirectionToUnreal(const float* Ours) { return FVector(Ours[0], -Ours[1], Ours[2]); }
// One frame is the mirror image of the other, so a rotation turns the other way; so do angular velocities and impulses.
inline FQuat ToUnreal(const float* Ours) { return FQuat(-Ours[0], Ours[1], -Ours[2], Ours[3]); }
inline CrumplePose FromUnreal(const FVector& Position, const FQuat& Rotation) {
  return {{0.01 * Position.X, -0.01 * Position.Y, 0.01 * Position.Z},
          {float(-Rotation.X), float(Rotation.Y), float(-Rotation.Z), float(Rotation.W)}};
}
}  // namespace CrumpleAxes

struct FCrumpleSession {
  Crumple* Handle = nullptr;
  TMap<FString, uint32> Mappings;  // all cars share them, because a session has at most 1024
  ~FCrumpleSession() { crumple_close(Handle); }
};

// A section of the drawn mesh. The lists of floats are as the library writes them, 3 for each vertex.
struct FCrumpleSection {
  int32 Index = 0;
  uint32 Mapping = 0;  // 0: the baked surface
  TArray<float> Position, Normal, Tangent;
  TArray<FVector> Vertices, Normals;
  TArray<int32> Triangles;
  TArray<FVector2D> UVs;  // these two only of a mesh of the game
  TArray<FProcMeshTangent> Tangents;
};

UCLASS(ClassGroup = (Crumple), meta = (BlueprintSpawnableComponent))
class UCrumpleCarComponent : public UProceduralMeshComponent {
  GENERATED_BODY()

 public:
  explicit UCrumpleCarComponent(const FObjectInitializer& Initializer);

  UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "Crumple")
  FString Endpoint = TEXT("tcp/127.0.0.1:7447");
  UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "Crumple")
  FString Scene = TEXT("main");
  UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "Crumple")
  FString Car = TEXT("car1");
  // s, for the connection; the game stands still meanwhile
  UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "Crumple")
  float Timeout = 2;
  // s: the component shows the car as it was so long ago. Use the same delay for the poses: then the car moves smoothly,
  // however unevenly messages come.
  UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "Crumple")
  float Delay = 0.1f;
  // A mesh of the game, which the component draws instead of the baked surface. The transform of the component, relative to the
  // component that moves as the car, is then the place of the mesh in the car.
  UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "Crumple")
  UStaticMesh* OwnMesh = nullptr;
  // Must be shown where the car is shown.
  UPROPERTY(BlueprintReadOnly, Category = "Crumple")
  FString Attribution;

  void BeginPlay() override;
  void EndPlay(const EEndPlayReason::Type Reason) override;
  void TickComponent(float DeltaTime, ELevelTick Type, FActorComponentTickFunction* Function) override;

 private:
  bool Build(const char* Hash);
  bool Map(const char* Hash, FCrumpleSection& Section);
  void Draw(FCrumpleSection& Section, uint32 First, uint32 Count, bool bAnother);

  TSharedPtr<FCrumpleSession> Session;
  FString Asset;
  TArray<FCrumpleSection> Sections;
};
