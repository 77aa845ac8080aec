// A car of a scene in Unreal Engine 5, as it dents. Belongs below the component that the game moves as the car. Not seen in
// Unreal yet: README.md.
#pragma once

#include <ProceduralMeshComponent.h>
#include <crumple_client.h>
// clang-format off
#include "CrumpleCarComponent.generated.h"  // Unreal wants it last
// clang-format on

// Between our axes (a car is x forward, y left, z up; right-handed; m) and Unreal's (x forward, y right, z up; left-handed,
// cm).
namespace CrumpleAxes {
inline FVector PointToUnreal(const float* Ours) { return FVector(100.0 * Ours[0], -100.0 * Ours[1], 100.0 * Ours[2]); }
inline FVector DirectionToUnreal(const float* Ours) { return FVector(Ours[0], -Ours[1], Ours[2]); }
// One is the other's mirror image, so the axis of a turn goes the other way round; so do angular velocities and impulses.
inline FQuat ToUnreal(const float* Ours) { return FQuat(-Ours[0], Ours[1], -Ours[2], Ours[3]); }
inline CrumplePose FromUnreal(const FVector& Position, const FQuat& Rotation) {
  return {{0.01 * Position.X, -0.01 * Position.Y, 0.01 * Position.Z},
          {float(-Rotation.X), float(Rotation.Y), float(-Rotation.Z), float(Rotation.W)}};
}
}  // namespace CrumpleAxes

struct FCrumpleSession {
  Crumple* Handle = nullptr;
  ~FCrumpleSession() { crumple_close(Handle); }
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
  // s, for the connection; the game stands still while there is none
  UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "Crumple")
  float Timeout = 2;
  // s: shows what was then, the same as for the poses; moves smoothly however unevenly messages come
  UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "Crumple")
  float Delay = 0.1f;
  // Must be shown where the car is shown.
  UPROPERTY(BlueprintReadOnly, Category = "Crumple")
  FString Attribution;

  void BeginPlay() override;
  void EndPlay(const EEndPlayReason::Type Reason) override;
  void TickComponent(float DeltaTime, ELevelTick Type, FActorComponentTickFunction* Function) override;

 private:
  bool Build(const char* Hash);

  TSharedPtr<FCrumpleSession> Session;
  FString Asset;
  TArray<float> Position, Normal;  // 3 a vertex, as the library writes them
  TArray<FVector> Vertices, Normals;
  TArray<int32> Triangles;
};
