#pragma once

#include <Engine/StaticMesh.h>

struct UKismetProceduralMeshLibrary {
  static void GetSectionFromStaticMesh(UStaticMesh* mesh, int32, int32 index, TArray<FVector>& vertices,
                                       TArray<int32>& triangles, TArray<FVector>& normals, TArray<FVector2D>& uvs,
                                       TArray<FProcMeshTangent>& tangents) {
    const auto& from = mesh->section.at(size_t(index));
    vertices = from.vertices, triangles = from.corners, normals = from.normals, uvs = from.uvs, tangents = from.tangents;
  }
};
