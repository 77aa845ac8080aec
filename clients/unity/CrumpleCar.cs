// Shows a car of a scene in Unity (2019.3 or newer) as it dents. The library writes into the memory of a NativeArray, and this
// component passes the vertices that changed to the graphics card. Put it on a child of the object that the game moves as the
// car, because it uses the transform of that child to convert the axes. Only Unity compiles this file.
#if UNITY_5_3_OR_NEWER
using System;
using System.Collections.Generic;
using Unity.Collections;
using Unity.Collections.LowLevel.Unsafe;
using UnityEngine;
using UnityEngine.Rendering;

namespace Crumple {

[RequireComponent(typeof(MeshFilter), typeof(MeshRenderer))]
public sealed unsafe class CrumpleCar : MonoBehaviour {
  public string endpoint = "tcp/127.0.0.1:7447";
  public string scene = "main";
  public string car = "car1";
  public float timeout = 2;   // s, for the connection; Unity stands still meanwhile
  // s: the component shows the car as it was so long ago. Use the same delay for the poses: then the car moves smoothly,
  // however unevenly messages come.
  public float delay = 0.1f;

  /// Must be shown where the car is shown.
  public string Attribution { get; private set; }

  struct Vertex {
    public Vector3 position, normal;
  }
  static readonly VertexAttributeDescriptor[] layout = {
    new VertexAttributeDescriptor(VertexAttribute.Position, VertexAttributeFormat.Float32, 3),
    new VertexAttributeDescriptor(VertexAttribute.Normal, VertexAttributeFormat.Float32, 3)
  };

  // Cars of one scene share a session; the first of them in each frame polls it.
  sealed class Shared {
    public Session session;
    public int users, frame;
  }
  static readonly Dictionary<string, Shared> sessions = new Dictionary<string, Shared>();

  string where;
  Shared shared;
  IntPtr asset;
  UnityEngine.Mesh drawn;
  NativeArray<Vertex> buffer;
  Vertices vertices;

  void OnEnable() {
    where = endpoint + " " + scene;
    Shared found;
    if (!sessions.TryGetValue(where, out found))
      sessions.Add(where, found = new Shared { session = new Session(endpoint, scene, seconds: timeout) });
    shared = found;
    ++shared.users;
    shared.session.Follow(car);
    Rotation turn = Axes.MeshRotation;
    transform.localPosition = Vector3.zero;
    transform.localRotation = new Quaternion(turn.X, turn.Y, turn.Z, turn.W);
    transform.localScale = new Vector3(Axes.MeshScale.X, Axes.MeshScale.Y, Axes.MeshScale.Z);
  }

  void OnDisable() {
    Clear();
    if (shared != null && --shared.users == 0) {
      sessions.Remove(where);
      shared.session.Dispose();
    }
    shared = null;
  }

  void Update() {
    if (shared == null) return;  // OnEnable threw, and said why
    if (shared.frame != Time.frameCount) shared.session.Poll();
    shared.frame = Time.frameCount;
    Surface surface;
    if (!shared.session.TrySurface(car, out surface)) return;
    bool build = drawn == null || !surface.IsOf(asset);
    if (build && !Build(surface.Asset)) return;
    vertices.Time = shared.session.Time - delay;
    if (!shared.session.Copy(car, ref vertices)) return;
    if (build) asset = shared.session.Id(surface.Asset);  // only now the mesh is complete; until then each frame builds it anew
    // Copy names a changed vertex only once; a new mesh needs all of them.
    int first = build ? 0 : (int)vertices.First, count = build ? buffer.Length : (int)vertices.Count;
    if (count > 0)
      drawn.SetVertexBufferData(buffer, first, first, count, 0,
                                MeshUpdateFlags.DontRecalculateBounds | MeshUpdateFlags.DontValidateIndices);
  }

  // Returns false until the undamaged car has come.
  bool Build(string name) {
    Mesh mesh;
    if (!shared.session.TryMesh(name, out mesh)) return false;
    Clear();
    Attribution = mesh.Attribution;
    int count = (int)mesh.VertexCount, corners = 3 * (int)mesh.TriangleCount;
    drawn = new UnityEngine.Mesh { name = mesh.Name };
    drawn.MarkDynamic();
    drawn.SetVertexBufferParams(count, layout);
    drawn.SetIndexBufferParams(corners, IndexFormat.UInt32);
    using (var triangles = new NativeArray<uint>(corners, Allocator.Temp)) {
      UnsafeUtility.MemCpy(triangles.GetUnsafePtr(), (void*)mesh.Triangle, 4L * corners);
      drawn.SetIndexBufferData(triangles, 0, 0, corners, MeshUpdateFlags.DontValidateIndices);
    }
    drawn.subMeshCount = 1;
    drawn.SetSubMesh(0, new SubMeshDescriptor(0, corners), MeshUpdateFlags.DontRecalculateBounds);
    drawn.bounds = new Bounds(Vector3.zero, 20 * Vector3.one);  // m; a car fits in it, dented or not
    GetComponent<MeshFilter>().sharedMesh = drawn;

    buffer = new NativeArray<Vertex>(count, Allocator.Persistent);
    var start = (IntPtr)buffer.GetUnsafePtr();
    vertices = new Vertices { Position = start, Normal = start + sizeof(Vector3), Stride = sizeof(Vertex), Capacity = count };
    return true;
  }

  void Clear() {
    if (drawn == null) return;
    Destroy(drawn);
    drawn = null;
    asset = IntPtr.Zero;
    buffer.Dispose();
  }
}

}  // namespace Crumple
#endif
