#include "CrumpleCarComponent.h"

namespace {

// Cars of one scene share a session, as long as there are any.
TMap<FString, TWeakPtr<FCrumpleSession>> Sessions;

// Logs the library's sentence. Returns false also while something has not come yet.
bool Good(int Status) {
  if (Status < 0) UE_LOG(LogTemp, Error, TEXT("crumple: %s"), UTF8_TO_TCHAR(crumple_error()));
  return Status == CRUMPLE_OK;
}

}  // namespace

UCrumpleCarComponent::UCrumpleCarComponent(const FObjectInitializer& Initializer) : Super(Initializer) {
  PrimaryComponentTick.bCanEverTick = true;
}

void UCrumpleCarComponent::BeginPlay() {
  Super::BeginPlay();
  TWeakPtr<FCrumpleSession>& Shared = Sessions.FindOrAdd(Endpoint + TEXT(" ") + Scene);
  Session = Shared.Pin();
  if (!Session.IsValid()) {
    Session = MakeShared<FCrumpleSession>();
    const FTCHARToUTF8 Where(*Endpoint), Which(*Scene);
    CrumpleOptions Options = {};
    Options.version = CRUMPLE_CLIENT_VERSION;
    Options.timeout_ms = uint32(FMath::Max(1.0f, 1000 * Timeout));
    Options.connect = Where.Get();
    Options.scene = Which.Get();
    if (!Good(crumple_open(&Options, &Session->Handle))) {
      Session.Reset();
      return;
    }
    Shared = Session;
  }
  Good(crumple_follow(Session->Handle, TCHAR_TO_UTF8(*Car), 0));
}

void UCrumpleCarComponent::EndPlay(const EEndPlayReason::Type Reason) {
  Session.Reset();
  Super::EndPlay(Reason);
}

void UCrumpleCarComponent::TickComponent(float DeltaTime, ELevelTick Type, FActorComponentTickFunction* Function) {
  Super::TickComponent(DeltaTime, Type, Function);
  if (!Session.IsValid()) return;  // BeginPlay has logged why
  Crumple* Handle = Session->Handle;
  const FTCHARToUTF8 Id(*Car);
  crumple_poll(Handle, 0);
  CrumpleSurface Surface;
  if (!Good(crumple_surface(Handle, Id.Get(), &Surface))) return;  // the drawn mesh stays
  const FString Hash = UTF8_TO_TCHAR(Surface.asset);
  const bool bAnother = Hash != Asset;
  if (bAnother && !Build(Surface.asset)) return;
  CrumpleVertices Out = {};
  Out.position = Position.GetData();
  Out.normal = Normal.GetData();
  Out.stride = 12;
  Out.capacity = size_t(Vertices.Num());
  Out.time = crumple_time(Handle) - Delay;
  if (!Good(crumple_copy(Handle, Id.Get(), &Out))) return;
  // crumple_copy names a changed vertex only once; a new mesh needs all of them.
  const uint32 First = bAnother ? 0 : Out.first, Count = bAnother ? uint32(Vertices.Num()) : Out.count;
  for (uint32 I = First; I < First + Count; ++I) {
    Vertices[I] = CrumpleAxes::PointToUnreal(&Position[3 * I]);
    Normals[I] = CrumpleAxes::DirectionToUnreal(&Normal[3 * I]);
  }
  if (bAnother)
    CreateMeshSection(0, Vertices, Triangles, Normals, TArray<FVector2D>(), TArray<FColor>(), TArray<FProcMeshTangent>(),
                      false);
  else if (Count > 0)
    UpdateMeshSection(0, Vertices, Normals, TArray<FVector2D>(), TArray<FColor>(), TArray<FProcMeshTangent>());
  Asset = Hash;
}

// Returns false until the undamaged car has come.
bool UCrumpleCarComponent::Build(const char* Hash) {
  CrumpleMesh Mesh;
  if (!Good(crumple_mesh(Session->Handle, Hash, &Mesh))) return false;
  Attribution = UTF8_TO_TCHAR(Mesh.attribution);
  const int32 Count = int32(Mesh.vertex_count);
  Position.SetNumZeroed(3 * Count);
  Normal.SetNumZeroed(3 * Count);
  Vertices.SetNumZeroed(Count);
  Normals.SetNumZeroed(Count);
  // The triangles stay as they are: front sides are counterclockwise in Unreal's space, and in ours too.
  Triangles.SetNumZeroed(3 * int32(Mesh.triangle_count));
  for (int32 I = 0; I < Triangles.Num(); ++I) Triangles[I] = int32(Mesh.triangle[I]);
  return true;
}
