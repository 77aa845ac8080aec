// The commands with which tests/clients/clients_test.py tests the C# binding:
//   layout                 prints name, size and offsets of every struct, to compare with the header
//   axes                   checks the laws of the conversion of axes
//   car ENDPOINT CAR       runs the sample with a stand-in of Unity until the car is gone; prints its dent and the allocations
//   commands ENDPOINT FILE runs a host: all commands, a crash, refusals
using System;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Reflection;
using System.Runtime.InteropServices;
using Crumple;

static class UnityTest {
  const BindingFlags all = BindingFlags.Instance | BindingFlags.NonPublic | BindingFlags.Public;

  static GCHandle Pinned(float[] list) { return GCHandle.Alloc(list, GCHandleType.Pinned); }

  // A mesh in Unity's axes moves as the baked car does.
  static void CheckOwnMesh(Session session, string car, string asset, Mesh mesh, float[] vertex) {
    session.Follow(car);
    var baked = new float[vertex.Length];
    var own = new float[vertex.Length];
    Func<float[], int, Float3> at = (list, i) => new Float3(list[i], list[i + 1], list[i + 2]);
    for (int i = 0; i < vertex.Length; i += 3) {
      Float3 placed = Axes.ToUnity(Wide(at(vertex, i)));
      own[i] = placed.X; own[i + 1] = placed.Y; own[i + 2] = placed.Z;
    }
    double[] toCar = { 0, 0, 1, 0, -1, 0, 0, 0, 0, 1, 0, 0 };
    GCHandle matrix = GCHandle.Alloc(toCar, GCHandleType.Pinned), to = Pinned(own), of = Pinned(baked);
    var given = new OwnMesh { Position = to.AddrOfPinnedObject(), ToCar = matrix.AddrOfPinnedObject(), Stride = 12,
                              Count = (int)mesh.VertexCount };
    uint mapping;
    for (DateTime limit = DateTime.Now.AddSeconds(60); !session.TryMap(asset, ref given, out mapping) && DateTime.Now < limit;) session.Poll(0.1);
    Need(mapping > 0, "the mesh is mapped");
    Need(given.OnVertices == mesh.VertexCount && given.Farthest < 1e-4, "each vertex lies on one of the baked car");
    var mapped = new Vertices { Position = to.AddrOfPinnedObject(), Stride = 12, Capacity = given.Count, Mapping = mapping };
    var plain = new Vertices { Position = of.AddrOfPinnedObject(), Stride = 12, Capacity = given.Count };
    float deepest = 0;
    for (DateTime limit = DateTime.Now.AddSeconds(60); deepest < 0.02 && DateTime.Now < limit; session.Poll(0.1)) {
      if (!session.Copy(car, ref plain) || !session.Copy(car, ref mapped)) continue;
      for (int i = 0; i < vertex.Length; i += 3) {
        Need(Same(Axes.ToUnity(Wide(at(baked, i))), at(own, i)), "vertex " + i / 3);
        deepest = Math.Max(deepest, Math.Abs(baked[i] - vertex[i]));
      }
    }
    Need(deepest >= 0.02, "the car is dented");
    matrix.Free(); to.Free(); of.Free();
  }

  static void Layout() {
    var structs = typeof(Session).Assembly.GetTypes().Where(each => each.Namespace == "Crumple" && each.IsValueType);
    foreach (Type type in structs.Where(each => !each.IsEnum))
      foreach (FieldInfo field in type.GetFields(all))
        Console.WriteLine("{0} {1} {2} {3}", type.Name, Marshal.SizeOf(type), field.Name, Marshal.OffsetOf(type, field.Name));
  }

  static void Need(bool holds, string what) {
    if (!holds) throw new Exception(what);
  }

  static bool Same(Float3 a, Float3 b) { return Math.Abs(a.X - b.X) + Math.Abs(a.Y - b.Y) + Math.Abs(a.Z - b.Z) < 1e-5; }

  // v + 2 u x (u x v + w v): this formula holds in right-handed and in left-handed axes.
  static Float3 Turn(Rotation q, Float3 v) {
    float x = q.Y * v.Z - q.Z * v.Y + q.W * v.X, y = q.Z * v.X - q.X * v.Z + q.W * v.Y, z = q.X * v.Y - q.Y * v.X + q.W * v.Z;
    return new Float3(v.X + 2 * (q.Y * z - q.Z * y), v.Y + 2 * (q.Z * x - q.X * z), v.Z + 2 * (q.X * y - q.Y * x));
  }

  static Double3 Wide(Float3 v) { return new Double3(v.X, v.Y, v.Z); }

  static void TestAxes() {
    Need(Same(Axes.ToUnity(new Double3(1, 0, 0)), new Float3(0, 0, 1)), "forward is z");
    Need(Same(Axes.ToUnity(new Double3(0, 1, 0)), new Float3(-1, 0, 0)), "left is -x");
    Need(Same(Axes.ToUnity(new Double3(0, 0, 1)), new Float3(0, 1, 0)), "up is y");
    var random = new Random(1);
    Func<float> next = () => (float)(2 * random.NextDouble() - 1);
    for (int i = 0; i < 100; ++i) {
      var v = new Float3(next(), next(), next());
      var q = new Rotation(next(), next(), next(), next());
      float length = (float)Math.Sqrt(q.X * q.X + q.Y * q.Y + q.Z * q.Z + q.W * q.W);
      q = new Rotation(q.X / length, q.Y / length, q.Z / length, q.W / length);
      Float3 there = Axes.ToUnity(Wide(v));
      Double3 back = Axes.FromUnity(there);
      Need(Same(v, new Float3((float)back.X, (float)back.Y, (float)back.Z)), "a point comes back");
      Rotation same = Axes.FromUnity(Axes.ToUnity(q));
      Need(same.X == q.X && same.Y == q.Y && same.Z == q.Z && same.W == q.W, "a rotation comes back");
      Need(Same(Axes.ToUnity(Wide(Turn(q, v))), Turn(Axes.ToUnity(q), there)), "turned, then converted, and the other way round");
      var scaled = new Float3(Axes.MeshScale.X * v.X, Axes.MeshScale.Y * v.Y, Axes.MeshScale.Z * v.Z);
      Need(Same(Turn(Axes.MeshRotation, scaled), there), "the transform of the mesh is the conversion");
    }
    Console.WriteLine("axes hold");
  }

  static float[] Drawn(CrumpleCar car) {
    var floats = new float[car.GetComponent<UnityEngine.MeshFilter>().sharedMesh.vertices.Length / 4];
    Buffer.BlockCopy(car.GetComponent<UnityEngine.MeshFilter>().sharedMesh.vertices, 0, floats, 0, 4 * floats.Length);
    return floats;
  }

  static void Car(string endpoint, string id) {
    var car = new CrumpleCar { endpoint = endpoint, car = id, timeout = 30 };
    var update = (Action)Delegate.CreateDelegate(typeof(Action), car, typeof(CrumpleCar).GetMethod("Update", all));
    Action<string> call = name => typeof(CrumpleCar).GetMethod(name, all).Invoke(car, null);
    float[] first = null;
    using (var other = new Session(endpoint, seconds: 30)) {
      call("OnEnable");
      other.Follow(id);
      Surface surface;
      for (bool alive = true; alive; ++UnityEngine.Time.frameCount) {
        update();
        other.Poll(0.01);
        if (other.TrySurface(id, out surface)) alive = surface.Alive;
        if (first != null || car.GetComponent<UnityEngine.MeshFilter>().sharedMesh == null) continue;
        first = Drawn(car);
        Console.WriteLine("drawn");
      }
      // The shown surface is a tenth of a second old.
      for (DateTime end = DateTime.Now.AddSeconds(0.5); DateTime.Now < end; ++UnityEngine.Time.frameCount) {
        update();
        other.Poll(0.01);
      }
    }
    float[] last = Drawn(car);
    double deepest = 0;
    for (int i = 0; i < last.Length; i += 6) {
      double x = last[i] - first[i], y = last[i + 1] - first[i + 1], z = last[i + 2] - first[i + 2];
      deepest = Math.Max(deepest, Math.Sqrt(x * x + y * y + z * z));
      double normal = last[i + 3] * last[i + 3] + last[i + 4] * last[i + 4] + last[i + 5] * last[i + 5];
      Need(Math.Abs(normal - 1) < 1e-4, "a normal is of length 1");
    }
    long before = GC.GetAllocatedBytesForCurrentThread();
    for (int i = 0; i < 200; ++i, ++UnityEngine.Time.frameCount) update();
    long after = GC.GetAllocatedBytesForCurrentThread();
    // A second component on the same session must draw too, although the surface no longer changes.
    var second = new CrumpleCar { endpoint = endpoint, car = id };
    foreach (string name in new[] { "OnEnable", "Update" }) typeof(CrumpleCar).GetMethod(name, all).Invoke(second, null);
    Need(Drawn(second).SequenceEqual(last), "a second component draws the same");
    call("OnDisable");
    typeof(CrumpleCar).GetMethod("OnDisable", all).Invoke(second, null);
    Console.WriteLine("{0}: deepest dent {1:f0} mm; 200 frames allocated {2} bytes", id, 1000 * deepest, after - before);
    Console.WriteLine(car.Attribution);
  }

  static void Refuses<Kind>(Action action, string part) where Kind : Error {
    try {
      action();
    } catch (Kind error) {
      Need(error.Message.Contains(part), error.Message + " says nothing of " + part);
      return;
    }
    throw new Exception("nothing was refused: " + part);
  }

  static void Commands(string endpoint, string file) {
    using (var host = new Session(endpoint, host: "unity", seconds: 30)) {
      string asset = host.AddAsset(File.ReadAllBytes(file));
      var pose = new Pose(new Double3(), Rotation.None);
      Refuses<Refused>(() => host.Repair("car2"), "car2");
      ulong spawned = host.Spawn("car2", asset, pose);
      var wrong = Parameters.Keep;
      wrong.YieldStrain = -1;
      Refuses<Refused>(() => host.SetParameters("car2", wrong), "yield_strain");
      var right = Parameters.Keep;
      right.Iterations = 12;
      Need(host.SetParameters("car2", right) > spawned, "parameters are taken");
      Refuses<Error>(() => { Surface none; host.TrySurface("car3", out none); }, "crumple_follow");
      Refuses<Error>(() => new Session(endpoint, "other", seconds: 0.2), "no server of scene other");

      Mesh mesh;
      Need(host.TryMesh(asset, out mesh), "the mesh was given");
      float nose = 0;
      var vertex = new float[3 * mesh.VertexCount];
      Marshal.Copy(mesh.Vertex, vertex, 0, vertex.Length);
      for (int i = 0; i < vertex.Length; i += 3) nose = Math.Max(nose, vertex[i]);
      host.PublishObstacles(new[] {
        new Obstacle { Id = 1, Shape = Shape.Box, Size = new Float3(1, 5, 5), Friction = 0.3f,
                       Pose = new Pose(new Double3(nose + 1.5, 0, 0), Rotation.None) }
      });
      var cars = new[] { new CarPose(host.Id("car2")) { Velocity = new Float3(14, 0, 0), Seen = spawned } };
      var reactions = new Reaction[64];
      double absorbed = 0;
      DateTime limit = DateTime.Now.AddSeconds(60);
      for (int i = 0; absorbed < 10e3 && DateTime.Now < limit; ++i) {
        host.PublishPoses(i / 60.0, cars, 1);
        host.Poll(1 / 60.0);
        cars[0].Pose.Position.X += cars[0].Velocity.X / 60.0;
        for (int got = host.TakeReactions(reactions), k = 0; k < got; ++k) {
          Need(reactions[k].IsOf(host.Id("car2")) && reactions[k].Car == "car2", "a reaction names its car");
          cars[0].Pose = reactions[k].Pose;
          cars[0].Velocity = reactions[k].Velocity;
          cars[0].Seen = reactions[k].Tick;
          absorbed = reactions[k].EnergyAbsorbed;
        }
      }
      using (var viewer = new Session(endpoint)) CheckOwnMesh(viewer, "car2", asset, mesh, vertex);
      byte[] state = host.Save("car2");
      host.Repair("car2");
      host.Load("car2", state);
      Refuses<Refused>(() => host.Load("car2", new byte[] { 1, 2, 3 }), "");
      Health health;
      while (!host.TryHealth(out health)) host.Poll(0.1);
      host.Impair(new Impairment { Delay = 0.01f });  // the rest of the crash
      Need(health.Rate == 60 && host.Statistics.Received > 0 && host.Time > 0, "health and statistics are told");
      host.FollowAll(1);
      Surface far;
      while (!host.Cars().Contains("car2") || !host.TrySurface("car2", out far)) host.Poll(0.1);
      Need(far.IsOf(host.Id(asset)) && far.Asset == asset, "the car is held");
      Need(Math.Abs(far.Quantum - 0.004f) < 1e-6, "quantum of those far away");
      host.Despawn("car2");
      Console.WriteLine("{0:f0} kJ absorbed", absorbed / 1000);
    }
    var gone = new Session(null);
    gone.Dispose();
    gone.Dispose();
    try {
      gone.Poll();
    } catch (ObjectDisposedException) {
      return;
    }
    throw new Exception("a session that was disposed of polls");
  }

  static void Main(string[] arguments) {
    CultureInfo.CurrentCulture = CultureInfo.InvariantCulture;
    switch (arguments[0]) {
      case "layout": Layout(); break;
      case "axes": TestAxes(); break;
      case "car": Car(arguments[1], arguments[2]); break;
      case "commands": Commands(arguments[1], arguments[2]); break;
    }
  }
}
