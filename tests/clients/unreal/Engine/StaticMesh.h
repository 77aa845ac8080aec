// A mesh of the game, as far as CrumpleCarComponent uses it.
#pragma once

#include <ProceduralMeshComponent.h>

struct UStaticMesh {
  int32 GetNumSections(int32) const { return int32(section.size()); }
  UMaterialInterface* GetMaterial(int32 index) { return &material[size_t(index)]; }
  FString GetName() const { return name; }
  FString GetPathName() const { return "/Game/" + name; }
  FString name;
  std::vector<UProceduralMeshComponent::Drawn> section;
  UMaterialInterface material[4];
};
