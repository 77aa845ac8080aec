// Shows a car of a scene in Unreal Engine 5 as it dents. Attach it to the component that the game moves as the car. Nobody has
// run it in Unreal yet: README.md says what was tested.
#pragma once

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
  // s, for the connection; the game stands still meanwhile
  UPROPERTY(EditAnywhere, BlueprintReadWrite, Category = "Crumple")
  float Timeout = 2;
  // s: the component shows the car as it was so long ago. Use the same delay for the poses: then the car moves smoothly,
  // however unevenly messages come.
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
  TArray<float> Position, Normal;  // 3 for each vertex, as the library writes them
  TArray<FVector> Vertices, Normals;
  TArray<int32> Triangles;
};
