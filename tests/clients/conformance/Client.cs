// Runs the conformance table with the C# binding. run.py specifies its input and output.
using System;
using System.IO;
using System.Linq;
using System.Runtime.InteropServices;
using Crumple;

static class Client {
  static Session Begin() {
    var session = new Session(null);
    session.Follow("a");
    return session;
  }

  static ulong HeldTick(Session session) {
    Surface surface;
    return session.TrySurface("a", out surface) ? surface.Tick : 0;
  }

  static string Take(Session session, string path) {
    Statistics before = session.Statistics;
    ulong tick = HeldTick(session);
    try {
      session.Feed("crumple/1/main/car/a/" + (path.EndsWith(".keyframe") ? "key/0" : "delta/0"), File.ReadAllBytes(path));
    } catch (Error) {
      return "refused";
    }
    Statistics now = session.Statistics;
    if (now.Older > before.Older) return "old";
    if (now.Asked > before.Asked) return "missing keyframe";
    return HeldTick(session) == tick ? "part" : "applied";
  }

  const int Numbers = 9;  // of a vertex: position, normal, tangent
  static string asset;
  static float[] own;  // of a mesh of the game's own
  static uint mapping;

  static IntPtr Place(GCHandle pinned, int floats) { return pinned.AddrOfPinnedObject() + 4 * floats; }

  static void Map(Session session, string path) {
    byte[] bytes = File.ReadAllBytes(path);
    own = new float[Numbers * BitConverter.ToUInt32(bytes, 0)];
    Buffer.BlockCopy(bytes, 4, own, 0, 4 * own.Length);
    var pinned = GCHandle.Alloc(own, GCHandleType.Pinned);
    var mesh = new OwnMesh { Position = Place(pinned, 0), Normal = Place(pinned, 3), Tangent = Place(pinned, 6), Stride = 4 * Numbers,
                             Count = own.Length / Numbers };
    if (!session.TryMap(asset, ref mesh, out mapping)) throw new Exception("no mapping");
    pinned.Free();
    Console.WriteLine("{{\"outcome\": \"mapped\", \"vertices\": {0}, \"on_vertices\": {1}, \"farthest\": {2}}}", own.Length / Numbers,
                      mesh.OnVertices, mesh.Farthest.ToString("r"));
  }

  static string Row(double[] numbers) { return "[" + string.Join(", ", numbers.Select(each => each.ToString("r"))) + "]"; }

  static void PrintOwn(Session session) {
    var pinned = GCHandle.Alloc(own, GCHandleType.Pinned);
    var to = new Vertices { Position = Place(pinned, 0), Normal = Place(pinned, 3), Tangent = Place(pinned, 6), Stride = 4 * Numbers,
                            Capacity = own.Length / Numbers, Mapping = mapping };
    if (!session.Copy("a", ref to)) throw new Exception("no vertices");
    pinned.Free();
    var rows = Enumerable.Range(0, own.Length / Numbers).Select(i => Row(own.Skip(Numbers * i).Take(Numbers).Select(each => (double)each).ToArray()));
    Parts parts;
    session.TryParts(asset, out parts);
    var poses = Enumerable.Range(0, (int)parts.Count).Select(i => {
      Pose pose;
      session.TryPartPose("a", i, 0, out pose);
      Double3 p = pose.Position;
      Rotation q = pose.Orientation;
      return Row(new[] { p.X, p.Y, p.Z, q.X, q.Y, q.Z, q.W });
    });
    Console.Write(", \"own\": [{0}], \"poses\": [{1}]", string.Join(", ", rows), string.Join(", ", poses));
  }

  static void Main() {
    Session session = Begin();
    string line;
    while ((line = Console.ReadLine()) != null) {
      if (line == "") {
        session.Dispose();
        session = Begin();
        own = null;
        continue;
      }
      if (line.EndsWith(".car")) {
        asset = session.AddAsset(File.ReadAllBytes(line));
        Console.WriteLine("{\"outcome\": \"held\"}");
        continue;
      }
      if (line.EndsWith(".own")) {
        Map(session, line);
        continue;
      }
      Console.Write("{{\"outcome\": \"{0}\"", Take(session, line));
      Surface surface;
      if (session.TrySurface("a", out surface)) {
        var quanta = new short[3 * surface.NodeCount];
        Marshal.Copy(surface.Quanta, quanta, 0, quanta.Length);
        Console.Write(", \"tick\": {0}, \"hash\": \"{1:x16}\", \"nodes\": {2}, \"quantum_um\": {3}", surface.Tick, surface.Hash,
                      surface.NodeCount, Math.Round(1e6 * surface.Quantum));
        Console.Write(", \"sum\": {0}, \"moment\": {1}", quanta.Sum(each => (long)each),
                      quanta.Select((each, k) => (long)k * each).Sum());
        if (own != null) PrintOwn(session);
      }
      Console.WriteLine("}");
    }
    session.Dispose();
  }
}
