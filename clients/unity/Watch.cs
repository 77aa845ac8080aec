// This viewer prints to the console what Crumple.cs receives of one car, until the car is gone.
//   mono Watch.exe tcp/127.0.0.1:7447 car1
using System;
using System.Runtime.InteropServices;
using Crumple;

static class Watch {
  struct Vertex {  // as an engine draws it
    public Float3 Position, Normal;
  }

  static void View(string endpoint, string car) {
    using (var session = new Session(endpoint, seconds: 10)) {
      session.Follow(car);
      Surface surface;
      while (!session.TrySurface(car, out surface)) session.Poll(0.1);
      string asset = surface.Asset;
      Mesh mesh;
      while (!session.TryMesh(asset, out mesh)) session.Poll(0.1);

      // The library writes into this memory, so it is pinned. The memory of a NativeArray needs no pinning.
      var buffer = new Vertex[mesh.VertexCount];
      GCHandle pinned = GCHandle.Alloc(buffer, GCHandleType.Pinned);
      var vertices = new Vertices {
        Position = pinned.AddrOfPinnedObject(), Normal = pinned.AddrOfPinnedObject() + 12,
        Stride = Marshal.SizeOf(typeof(Vertex)), Capacity = buffer.Length
      };
      bool alive = true;
      while (alive) {
        session.Poll(0.016);  // a frame; an engine does not wait here
        // The surface of a tenth of a second ago: smooth even if messages come unevenly.
        vertices.Time = session.Time - 0.1;
        if (session.Copy(car, ref vertices) && vertices.Count > 0)
          Console.WriteLine("{0} vertices from {1} on changed", vertices.Count, vertices.First);
        if (session.TrySurface(car, out surface)) alive = surface.Alive;
      }
      vertices.Time = 0;  // the newest
      if (!session.Copy(car, ref vertices)) throw new Error("the car was despawned while the viewer was stopped");
      pinned.Free();

      double deepest = 0;
      var rest = new float[3 * buffer.Length];
      Marshal.Copy(mesh.Vertex, rest, 0, rest.Length);
      for (int i = 0; i < buffer.Length; ++i) {
        Float3 now = buffer[i].Position;
        double x = now.X - rest[3 * i], y = now.Y - rest[3 * i + 1], z = now.Z - rest[3 * i + 2];
        deepest = Math.Max(deepest, Math.Sqrt(x * x + y * y + z * z));
      }
      Console.WriteLine("{0}: tick {1}, hash {2:x16}, deepest dent {3:f0} mm", car, surface.Tick, surface.Hash, 1000 * deepest);
      Console.WriteLine(mesh.Attribution);
    }
  }

  static int Main(string[] arguments) {
    try {
      if (arguments.Length != 2) throw new Error("usage: Watch.exe ENDPOINT CAR");
      View(arguments[0], arguments[1]);
      return 0;
    } catch (Error error) {
      Console.Error.WriteLine("Watch: " + error.Message);
      return 1;
    }
  }
}
