// The part of Unity that CrumpleCar.cs uses, with the signatures of the scripting reference, so that the sample can be compiled
// and run without Unity. A mesh keeps its data; nothing is drawn.
using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;

namespace UnityEngine {
public struct Vector3 {
  public float x, y, z;
  public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
  public static Vector3 zero { get { return new Vector3(); } }
  public static Vector3 one { get { return new Vector3(1, 1, 1); } }
  public static Vector3 operator *(float s, Vector3 v) { return new Vector3(s * v.x, s * v.y, s * v.z); }
}
public struct Quaternion {
  public float x, y, z, w;
  public Quaternion(float x, float y, float z, float w) { this.x = x; this.y = y; this.z = z; this.w = w; }
}
public struct Bounds {
  public Vector3 center, size;
  public Bounds(Vector3 center, Vector3 size) { this.center = center; this.size = size; }
}
public static class Time {
  public static int frameCount { get; set; }
}
public class Object {
  public string name { get; set; }
  public static void Destroy(Object gone) {}
}
public class Component : Object {
  readonly Dictionary<Type, object> components = new Dictionary<Type, object>();
  public Transform transform { get { return GetComponent<Transform>(); } }
  public T GetComponent<T>() where T : new() {
    if (!components.ContainsKey(typeof(T))) components[typeof(T)] = new T();
    return (T)components[typeof(T)];
  }
}
public class MonoBehaviour : Component {}
public class Transform {
  public Vector3 localPosition { get; set; }
  public Vector3 localScale { get; set; }
  public Quaternion localRotation { get; set; }
}
public class MeshFilter {
  public Mesh sharedMesh { get; set; }
}
public class MeshRenderer {}
[AttributeUsage(AttributeTargets.Class)]
public sealed class RequireComponent : Attribute {
  public RequireComponent(Type one, Type two) {}
}

public sealed class Mesh : Object {
  public int subMeshCount { get; set; }
  public Bounds bounds { get; set; }
  public byte[] vertices;  // not in Unity: the data of the graphics card
  public uint[] corners;
  int vertexCount;
  public void MarkDynamic() {}
  public void SetVertexBufferParams(int vertexCount, params Rendering.VertexAttributeDescriptor[] attributes) {
    this.vertexCount = vertexCount;
    vertices = new byte[vertexCount * 12 * attributes.Length];
  }
  public void SetVertexBufferData<T>(Unity.Collections.NativeArray<T> data, int dataStart, int meshBufferStart, int count,
                                     int stream = 0, Rendering.MeshUpdateFlags flags = 0) where T : struct {
    int size = vertices.Length / vertexCount;
    if (size != Marshal.SizeOf(typeof(T)) || dataStart + count > data.Length) throw new ArgumentException("another layout");
    Marshal.Copy(data.memory + size * dataStart, vertices, size * meshBufferStart, size * count);
  }
  public void SetIndexBufferParams(int indexCount, Rendering.IndexFormat format) { corners = new uint[indexCount]; }
  public void SetIndexBufferData<T>(Unity.Collections.NativeArray<T> data, int dataStart, int meshBufferStart, int count,
                                    Rendering.MeshUpdateFlags flags = 0) where T : struct {
    for (int i = 0; i < count; ++i) corners[meshBufferStart + i] = (uint)Marshal.ReadInt32(data.memory, 4 * (dataStart + i));
  }
  public void SetSubMesh(int index, Rendering.SubMeshDescriptor part, Rendering.MeshUpdateFlags flags = 0) {
    if (index >= subMeshCount || part.indexCount != corners.Length) throw new ArgumentException("not all triangles");
  }
}
}

namespace UnityEngine.Rendering {
public enum VertexAttribute { Position, Normal }
public enum VertexAttributeFormat { Float32 }
public enum IndexFormat { UInt16, UInt32 }
public enum MeshTopology { Triangles }
[Flags]
public enum MeshUpdateFlags { Default = 0, DontValidateIndices = 1, DontRecalculateBounds = 8 }
public struct VertexAttributeDescriptor {
  public VertexAttributeDescriptor(VertexAttribute attribute, VertexAttributeFormat format, int dimension, int stream = 0) {}
}
public struct SubMeshDescriptor {
  public int indexStart, indexCount;
  public SubMeshDescriptor(int indexStart, int indexCount, MeshTopology topology = MeshTopology.Triangles) {
    this.indexStart = indexStart;
    this.indexCount = indexCount;
  }
}
}

namespace Unity.Collections {
public enum Allocator { Temp, Persistent }
public struct NativeArray<T> : IDisposable where T : struct {
  public IntPtr memory;  // not in Unity
  public int Length { get; private set; }
  public NativeArray(int length, Allocator allocator) : this() {
    Length = length;
    memory = Marshal.AllocHGlobal(length * Marshal.SizeOf(typeof(T)));
  }
  public void Dispose() { Marshal.FreeHGlobal(memory); }
}
}

namespace Unity.Collections.LowLevel.Unsafe {
public static unsafe class NativeArrayUnsafeUtility {
  public static void* GetUnsafePtr<T>(this NativeArray<T> array) where T : struct { return (void*)array.memory; }
}
public static unsafe class UnsafeUtility {
  public static void MemCpy(void* destination, void* source, long size) { Buffer.MemoryCopy(source, destination, size, size); }
}
}
