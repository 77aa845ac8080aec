// A car for tests that need no bake: a box of cells with six tets each. Its surface consists of the box's own nodes, and its
// middle third is anchored. It is written with the schema, so it is read and checked like any baked car.
#pragma once

#include <memory>
#include <vector>

#include "bake/build_constraints.h"
#include "car/build_skin.h"
#include "car/car.h"
#include "schema/car_generated.h"

namespace crumple {

struct BoxCells {
  int x = 9, y = 4, z = 3;
};

struct BoxMesh {
  TetMesh tets;
  std::vector<uint8_t> anchored;   // per node
  std::vector<uint32_t> surface;   // node of each vertex
  std::vector<uint32_t> triangle;  // 3 nodes per triangle, facing outward
};

// The box has this length (m) along x, centred at the origin; length, width and height are in the proportion 4.5 : 1.8 : 1.5.
// It stands on z = 0.
inline BoxMesh box_mesh(BoxCells cells, float length = 4.5f) {
  BoxMesh mesh;
  const auto at = [&](int x, int y, int z) { return uint32_t((z * (cells.y + 1) + y) * (cells.x + 1) + x); };
  const Vec3 size(length, 0.4f * length, length / 3);
  for (int z = 0; z <= cells.z; ++z) {
    for (int y = 0; y <= cells.y; ++y) {
      for (int x = 0; x <= cells.x; ++x) {
        const Vec3 share(float(x) / float(cells.x) - 0.5f, float(y) / float(cells.y) - 0.5f, float(z) / float(cells.z));
        mesh.tets.node.push_back(share.cwiseProduct(size));
        mesh.anchored.push_back(std::abs(share.x()) < 0.17f);
      }
    }
  }
  // Kuhn's six tets of a cell: one for each order of the axes, along the path from the lowest corner to the highest. Faces of
  // neighbouring cells match.
  constexpr int orders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {1, 0, 2}, {2, 1, 0}};
  for (int z = 0; z < cells.z; ++z) {
    for (int y = 0; y < cells.y; ++y) {
      for (int x = 0; x < cells.x; ++x) {
        for (int k = 0; k < 6; ++k) {
          int corner[3] = {x, y, z};
          Tet tet;
          tet.node[0] = at(x, y, z);
          for (int step = 0; step < 3; ++step) {
            ++corner[orders[k][step]];
            tet.node[step + 1] = at(corner[0], corner[1], corner[2]);
          }
          if (k >= 3) std::swap(tet.node[2], tet.node[3]);  // odd orders are left-handed
          mesh.tets.tet.push_back(tet);
        }
      }
    }
  }
  std::vector<uint32_t> vertex_of(mesh.tets.node.size(), UINT32_MAX);
  const auto vertex = [&](uint32_t node) {
    if (vertex_of[node] == UINT32_MAX) {
      vertex_of[node] = uint32_t(mesh.surface.size());
      mesh.surface.push_back(node);
    }
    return vertex_of[node];
  };
  const int count[3] = {cells.x, cells.y, cells.z};
  for (int axis = 0; axis < 3; ++axis) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    for (int side = 0; side < 2; ++side) {
      for (int i = 0; i < count[u]; ++i) {
        for (int j = 0; j < count[v]; ++j) {
          const auto corner = [&](int di, int dj) {
            int c[3];
            c[axis] = side * count[axis];
            c[u] = i + di;
            c[v] = j + dj;
            return vertex(at(c[0], c[1], c[2]));
          };
          const uint32_t a = corner(0, 0), b = corner(1, 0), c = corner(1, 1), d = corner(0, 1);
          const std::vector<uint32_t> outward = side ? std::vector{a, b, c, a, c, d} : std::vector{a, c, b, a, d, c};
          mesh.triangle.insert(mesh.triangle.end(), outward.begin(), outward.end());
        }
      }
    }
  }
  return mesh;
}

// surface: the mesh whose outside is drawn. Cars with the same surface mesh are levels of one car.
inline std::vector<std::byte> box_car_bytes(BoxCells cells, float mass, float length, BoxCells surface) {
  const BoxMesh mesh = box_mesh(cells, length), drawn = box_mesh(surface, length);
  const Constraints constraints = build_constraints(mesh.tets);
  const Masses masses = lump_masses(mesh.tets, constraints.tet_rest, mass);
  std::vector<Vec3> vertex;
  for (uint32_t node : drawn.surface) vertex.push_back(drawn.tets.node[node]);
  const std::vector<Skin> skin = build_skin(mesh.tets, vertex).skin;
  flatbuffers::FlatBufferBuilder builder;
  const auto vec3s = [&](const std::vector<Vec3>& list) {
    return builder.CreateVectorOfStructs(reinterpret_cast<const schema::Vec3*>(list.data()), list.size());
  };
  const auto name = builder.CreateString("box"), attribution = builder.CreateString("made by the tests");
  const auto node = vec3s(mesh.tets.node);
  const auto node_mass = builder.CreateVector(masses.node);
  const auto node_region = builder.CreateVector(std::vector<uint8_t>(mesh.tets.node.size(), 0));
  const auto node_anchored = builder.CreateVector(mesh.anchored);
  const auto tet =
      builder.CreateVectorOfStructs(reinterpret_cast<const schema::Tet*>(mesh.tets.tet.data()), mesh.tets.tet.size());
  const auto gradients = builder.CreateVectorOfStructs(reinterpret_cast<const schema::Gradients*>(constraints.gradients.data()),
                                                       constraints.gradients.size());
  const auto tet_rest = builder.CreateVector(constraints.tet_rest);
  const auto tet_region = builder.CreateVector(std::vector<uint8_t>(mesh.tets.tet.size(), 0));
  const auto edge =
      builder.CreateVectorOfStructs(reinterpret_cast<const schema::Edge*>(constraints.edge.data()), constraints.edge.size());
  const auto edge_rest = builder.CreateVector(constraints.edge_rest);
  const auto node_first = builder.CreateVector(constraints.node_first), corner = builder.CreateVector(constraints.corner);
  const auto vertices = vec3s(vertex);
  const auto triangle = builder.CreateVector(drawn.triangle);
  const auto skins = builder.CreateVectorOfStructs(reinterpret_cast<const schema::Skin*>(skin.data()), skin.size());
  const auto region = builder.CreateVectorOfStrings({"body"});
  const schema::Vec3 center(masses.center.x(), masses.center.y(), masses.center.z());
  const schema::Vec3 inertia(masses.inertia.x(), masses.inertia.y(), masses.inertia.z());
  schema::CarBuilder car(builder);
  car.add_name(name);
  car.add_attribution(attribution);
  car.add_node(node);
  car.add_node_mass(node_mass);
  car.add_node_region(node_region);
  car.add_node_anchored(node_anchored);
  car.add_tet(tet);
  car.add_tet_gradients(gradients);
  car.add_tet_rest(tet_rest);
  car.add_tet_region(tet_region);
  car.add_edge(edge);
  car.add_edge_rest(edge_rest);
  car.add_node_first(node_first);
  car.add_corner(corner);
  car.add_vertex(vertices);
  car.add_triangle(triangle);
  car.add_skin(skins);
  car.add_region(region);
  car.add_mass(mass);
  car.add_center_of_mass(&center);
  car.add_inertia(&inertia);
  schema::FinishCarBuffer(builder, car.Finish());
  const auto* data = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return {data, data + builder.GetSize()};
}

inline std::vector<std::byte> box_car_bytes(BoxCells cells = {}, float mass = 1200, float length = 4.5f) {
  return box_car_bytes(cells, mass, length, cells);
}

inline std::shared_ptr<const Car> box_car(BoxCells cells = {}, float mass = 1200, float length = 4.5f) {
  return read_car(box_car_bytes(cells, mass, length), "box");
}

}  // namespace crumple
