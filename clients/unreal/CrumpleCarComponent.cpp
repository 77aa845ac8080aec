#include "CrumpleCarComponent.h"

#include <KismetProceduralMeshLibrary.h>

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
  const double Time = crumple_time(Handle) - Delay;
  for (FCrumpleSection& Section : Sections) {
    CrumpleVertices Out = {};
    Out.position = Section.Position.GetData();
    Out.normal = Section.Normal.GetData();
    Out.tangent = Section.Mapping ? Section.Tangent.GetData() : nullptr;
    Out.stride = 12;
    Out.capacity = size_t(Section.Vertices.Num());
    Out.time = Time;
    Out.mapping = Section.Mapping;
    if (!Good(crumple_copy(Handle, Id.Get(), &Out))) return;
    // crumple_copy names a changed vertex only once; a new mesh needs all of them.
    if (bAnother)
      Draw(Section, 0, uint32(Section.Vertices.Num()), true);
    else if (Out.count > 0)
      Draw(Section, Out.first, Out.count, false);
  }
  Asset = Hash;
}

// Converts the changed vertices to Unreal's axes and draws them. The numbers of a mesh of the game are in its own coordinates.
void UCrumpleCarComponent::Draw(FCrumpleSection& Section, uint32 First, uint32 Count, bool bAnother) {
  for (uint32 I = First; I < First + Count; ++I) {
    const float *P = &Section.Position[3 * I], *N = &Section.Normal[3 * I];
    Section.Vertices[I] = Section.Mapping ? FVector(P[0], P[1], P[2]) : CrumpleAxes::PointToUnreal(P);
    Section.Normals[I] = Section.Mapping ? FVector(N[0], N[1], N[2]) : CrumpleAxes::DirectionToUnreal(N);
    if (!Section.Mapping) continue;
    const float* T = &Section.Tangent[3 * I];
    Section.Tangents[I].TangentX = FVector(T[0], T[1], T[2]);
  }
  if (bAnother)
    CreateMeshSection(Section.Index, Section.Vertices, Section.Triangles, Section.Normals, Section.UVs, TArray<FColor>(),
                      Section.Tangents, false);
  else  // the texture coordinates stay, because the list is empty
    UpdateMeshSection(Section.Index, Section.Vertices, Section.Normals, TArray<FVector2D>(), TArray<FColor>(),
                      Section.Tangents);
}

// Returns false until the undamaged car has come.
bool UCrumpleCarComponent::Build(const char* Hash) {
  CrumpleMesh Mesh;
  if (!Good(crumple_mesh(Session->Handle, Hash, &Mesh))) return false;
  Attribution = UTF8_TO_TCHAR(Mesh.attribution);
  Sections.Empty();
  for (int32 I = 0; OwnMesh && I < OwnMesh->GetNumSections(0); ++I) {
    FCrumpleSection Section;
    Section.Index = I;
    UKismetProceduralMeshLibrary::GetSectionFromStaticMesh(OwnMesh, 0, I, Section.Vertices, Section.Triangles, Section.Normals,
                                                           Section.UVs, Section.Tangents);
    if (!GetMaterial(I)) SetMaterial(I, OwnMesh->GetMaterial(I));
    if (Map(Hash, Section)) Sections.Add(Section);
  }
  if (OwnMesh) return true;
  const int32 Count = int32(Mesh.vertex_count);
  FCrumpleSection Section;
  Section.Position.SetNumZeroed(3 * Count);
  Section.Normal.SetNumZeroed(3 * Count);
  Section.Vertices.SetNumZeroed(Count);
  Section.Normals.SetNumZeroed(Count);
  // The triangles stay as they are: front sides are counterclockwise in Unreal's space, and in ours too.
  Section.Triangles.SetNumZeroed(3 * int32(Mesh.triangle_count));
  for (int32 I = 0; I < Section.Triangles.Num(); ++I) Section.Triangles[I] = int32(Mesh.triangle[I]);
  Sections.Add(Section);
  return true;
}

// Binds a section of the game's mesh to the baked car. Logs what does not fit.
bool UCrumpleCarComponent::Map(const char* Hash, FCrumpleSection& Section) {
  const int32 Count = Section.Vertices.Num();
  Section.Position.SetNumZeroed(3 * Count);
  Section.Normal.SetNumZeroed(3 * Count);
  Section.Tangent.SetNumZeroed(3 * Count);
  const FString Name = FString::Printf(TEXT("section %d of mesh %s"), Section.Index, *OwnMesh->GetName());
  if (Count == 0) {
    UE_LOG(LogTemp, Error, TEXT("crumple: %s gives no vertices; set \"Allow CPU Access\" in the mesh"), *Name);
    return false;
  }
  const FTransform Place = GetRelativeTransform();
  uint32& Mapping = Session->Mappings.FindOrAdd(
      FString::Printf(TEXT("%s %s %d %s"), UTF8_TO_TCHAR(Hash), *OwnMesh->GetPathName(), Section.Index, *Place.ToString()));
  Section.Mapping = Mapping;
  if (Mapping) return true;

  for (int32 I = 0; I < Count; ++I) {
    const FVector From[] = {Section.Vertices[I], Section.Normals[I], Section.Tangents[I].TangentX};
    float* To[] = {&Section.Position[3 * I], &Section.Normal[3 * I], &Section.Tangent[3 * I]};
    for (int K = 0; K < 3; ++K) To[K][0] = float(From[K].X), To[K][1] = float(From[K].Y), To[K][2] = float(From[K].Z);
  }
  // The columns of the matrix are the mesh's axes and its origin in the car's frame.
  double ToCar[12];
  const FVector Origin = Place.TransformPosition(FVector(0, 0, 0));
  for (int K = 0; K < 4; ++K) {
    const FVector Column = K == 3 ? Origin : Place.TransformPosition(FVector(K == 0, K == 1, K == 2)) - Origin;
    ToCar[K] = 0.01 * Column.X, ToCar[4 + K] = -0.01 * Column.Y, ToCar[8 + K] = 0.01 * Column.Z;
  }
  CrumpleOwnMesh Own = {};
  Own.position = Section.Position.GetData();
  Own.normal = Section.Normal.GetData();
  Own.tangent = Section.Tangent.GetData();
  Own.stride = 12;
  Own.count = size_t(Count);
  Own.to_car = ToCar;
  if (crumple_map(Session->Handle, Hash, &Own, &Mapping) != CRUMPLE_OK) {
    UE_LOG(LogTemp, Error, TEXT("crumple: %s is not drawn: %s; correct the mesh"), *Name, UTF8_TO_TCHAR(crumple_error()));
    return false;
  }
  if (Own.farthest > 0.05f)
    UE_LOG(
        LogTemp, Warning,
        TEXT("crumple: a vertex of %s is %.2f m away from the baked surface, and %u of %d vertices lie on vertices of it; move "
             "the component to the place of the mesh in the car, or remove what the baked car does not have"),
        *Name, Own.farthest, Own.on_vertices, Count);
  Section.Mapping = Mapping;
  return true;
}
