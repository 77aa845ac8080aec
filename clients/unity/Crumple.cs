// crumple_client.h for C#, in .NET, Mono and Unity; this file uses nothing of Unity. Dispose closes a session, exceptions have
// the library's sentence, commands wait for their answer, and the library decodes surfaces straight into the caller's memory.
// Structs have the layout of the header's structs, and the header says what each field means, its unit, and how long a pointer
// is valid. Session.Poll, TrySurface, Copy, PublishPoses and TakeReactions allocate nothing. Only one thread at a time may use
// a session.
using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;
using System.Text;

namespace Crumple {

/// The library's sentence: what went wrong, and what to do.
public class Error : Exception {
  public Error(string sentence) : base(sentence) {}
}

/// The server's sentence: why it refused a command.
public sealed class Refused : Error {
  public Refused(string sentence) : base(sentence) {}
}

public struct Float3 {
  public float X, Y, Z;
  public Float3(float x, float y, float z) { X = x; Y = y; Z = z; }
}

public struct Double3 {
  public double X, Y, Z;
  public Double3(double x, double y, double z) { X = x; Y = y; Z = z; }
}

/// A unit quaternion.
public struct Rotation {
  public float X, Y, Z, W;
  public Rotation(float x, float y, float z, float w) { X = x; Y = y; Z = z; W = w; }
  public static readonly Rotation None = new Rotation(0, 0, 0, 1);
}

public struct Pose {
  public Double3 Position;
  public Rotation Orientation;
  public Pose(Double3 position, Rotation orientation) { Position = position; Orientation = orientation; }
}

/// Converts between our axes (right-handed; a car has x forward, y left, z up) and Unity's (left-handed; z forward, x right, y
/// up). You need not convert the vertices of a mesh: its transform, a child of the car's, applies MeshScale, then MeshRotation.
public static class Axes {
  public static Float3 ToUnity(Double3 ours) { return new Float3((float)-ours.Y, (float)ours.Z, (float)ours.X); }
  public static Double3 FromUnity(Float3 unity) { return new Double3(unity.Z, -unity.X, unity.Y); }
  // One frame is the mirror image of the other, so a rotation turns the other way; so do angular velocities and impulses.
  public static Rotation ToUnity(Rotation ours) { return new Rotation(ours.Y, -ours.Z, -ours.X, ours.W); }
  public static Rotation FromUnity(Rotation unity) { return new Rotation(-unity.Z, unity.X, -unity.Y, unity.W); }
  public static readonly Float3 MeshScale = new Float3(1, -1, 1);
  public static readonly Rotation MeshRotation = new Rotation(-0.5f, -0.5f, -0.5f, 0.5f);
}

public enum Shape { Box, Sphere, Capsule, HalfSpace, Hull }

public enum Solver { Keep = -1, Nodal, Classic }

public struct Statistics {
  public ulong Received, ReceivedBytes, Surface, SurfaceBytes, Older, Refused, Asked;
}

public struct Impairment {
  public float Delay, Jitter, Loss, Repeat;
  public uint Seed;
}

/// Begin with Parameters.Keep, which keeps every parameter, and set those that should change.
public struct Parameters {
  public Solver Solver;
  public uint Iterations, Substeps;
  public float Tolerance;
  public int Region;
  public float YoungModulus, PoissonRatio, YieldStrain, Hardening, PlasticLimit, Drag;
  public float HardeningStrain, Densification, DensificationStrain, Friction;
  public float DistanceStiffness, VolumeStiffness, Plasticity;
  public static Parameters Keep { get { return Native.crumple_keep(); } }
}

public struct CarPose {
  internal IntPtr car;
  public Pose Pose;
  public Float3 Velocity, AngularVelocity;
  public ulong Seen;
  public float Importance;
  /// car: what Session.Id gives for its name.
  public CarPose(IntPtr car) : this() { this.car = car; Pose.Orientation = Rotation.None; }
}

public struct Obstacle {
  public uint Id;
  public Shape Shape;
  public Float3 Size;
  public IntPtr Points;  // pinned by the caller
  public UIntPtr PointCount;
  public Pose Pose;
  public Float3 Velocity, AngularVelocity;
  public float Friction;
}

/// Another car that touched the car of a reaction in the same tick, or at the end of the tick before.
public struct Partner {
  internal IntPtr car, host;
  public Float3 Impulse;
  public uint Contacts;
  public string Car { get { return Native.Text(car); } }    // a new string each time
  public string Host { get { return Native.Text(host); } }  // a new string each time
  public bool IsOf(IntPtr id) { return Native.Same(car, id); }  // id: what Session.Id gives for the car's name
}

public struct Reaction {
  internal IntPtr car;
  public ulong Tick;
  public double Time;
  public Float3 Impulse, AngularImpulse;
  public Pose Pose;
  public Float3 Velocity, AngularVelocity;
  public double EnergyAbsorbed, EnergyStored;
  public float Deepest;
  public uint Contacts;
  public uint PartnerCount;
  internal IntPtr partners;
  public string Car { get { return Native.Text(car); } }  // a new string each time
  public bool IsOf(IntPtr id) { return Native.Same(car, id); }  // id: what Session.Id gives for the car's name
  /// Valid until the next TakeReactions. Allocates.
  public Partner PartnerAt(int k) {
    if (k < 0 || k >= PartnerCount) throw new ArgumentOutOfRangeException("k");
    return (Partner)Marshal.PtrToStructure(partners + k * Marshal.SizeOf(typeof(Partner)), typeof(Partner));
  }
}

public struct Surface {
  public ulong Tick, Hash;
  public uint NodeCount;
  public float Quantum;
  internal IntPtr asset;
  public IntPtr Quanta;  // short, 3 for each node; valid until the next Poll
  internal int dirty, alive;
  public string Asset { get { return Native.Text(asset); } }  // a new string each time
  public bool IsOf(IntPtr id) { return Native.Same(asset, id); }  // id: what Session.Id gives for the asset
  public bool Dirty { get { return dirty != 0; } }
  public bool Alive { get { return alive != 0; } }
}

/// Where Session.Copy writes: pointers to pinned memory, such as a NativeArray's, or zero to leave something out.
public struct Vertices {
  public IntPtr Position, Displacement, Normal;
  UIntPtr stride, capacity;
  public double Time;
  public uint First, Count;
  public uint Mapping;    // from Session.TryMap: the vertices of your own mesh; 0: those of Session.TryMesh
  public IntPtr Tangent;  // only with a mapping whose mesh has tangents
  public int Stride { get { return (int)stride; } set { stride = (UIntPtr)(uint)value; } }
  public int Capacity { get { return (int)capacity; } set { capacity = (UIntPtr)(uint)value; } }
}

/// A mesh of the car that you draw yourself, for Session.TryMap: pointers to 3 floats of each vertex in pinned memory.
public struct OwnMesh {
  public IntPtr Position, Normal, Tangent;  // zero: it has no normals, no tangents
  UIntPtr stride, count;
  public IntPtr ToCar;  // 12 doubles: rows of the 3 x 4 matrix to the car's frame; zero: positions are in the source's coordinates
  public uint OnVertices;
  public float Farthest;  // m
  public int Stride { get { return (int)stride; } set { stride = (UIntPtr)(uint)value; } }
  public int Count { get { return (int)count; } set { count = (UIntPtr)(uint)value; } }
}

/// The pointers stay valid as long as the session.
public struct Mesh {
  public uint VertexCount, TriangleCount;
  public IntPtr Vertex;    // float, 3 each
  public IntPtr Triangle;  // uint, 3 each
  public float Mass;
  public Float3 CenterOfMass;
  internal IntPtr name, attribution;
  public string Name { get { return Native.Text(name); } }
  public string Attribution { get { return Native.Text(attribution); } }
}

public enum PartKind { Body, Panel, Glass, Light, Wheel, Interior, Point }

/// A part of a car, with a frame of its own: the place of the frame at rest, in the car's frame. A wheel has its hub there and turns
/// about y of the frame; other parts have the middle of their vertices there.
public struct Part {
  internal IntPtr name;
  internal int kind;
  public Float3 Position;  // m
  public Rotation Orientation;
  public float Radius, Width;  // of a wheel, m
  public string Name { get { return Native.Text(name); } }
  public PartKind Kind { get { return (PartKind)kind; } }
}

/// The pointers stay valid as long as the session.
public struct Parts {
  public uint Count;  // 0: the car has only a body
  internal IntPtr part;
  public IntPtr VertexPart;  // byte: for each vertex of the mesh the index of its part
  public Part this[int i] {
    get {
      if (i < 0 || i >= Count) throw new ArgumentOutOfRangeException("i");
      return (Part)Marshal.PtrToStructure(part + i * Marshal.SizeOf(typeof(Part)), typeof(Part));
    }
  }
}

public struct Health {
  public ulong Tick, Late;
  public float Rate, TickMs, WorstMs;
  public ulong Refusals;
}

public sealed class Session : IDisposable {
  IntPtr handle;
  readonly Dictionary<string, IntPtr> ids = new Dictionary<string, IntPtr>();

  /// connect: "tcp/127.0.0.1:7447"; null: no network, Feed gives all messages. host: the id under which the session moves cars;
  /// null: a viewer only. seconds: for the connection and for each command. network: JSON5 in zenoh's own form.
  public Session(string connect, string scene = "main", string host = null, double seconds = 2, string network = null) {
    var options = new Options {
      version = Native.Version, timeout_ms = Math.Max(1, (uint)(1000 * seconds)), connect = Id(connect), scene = Id(scene),
      host = Id(host), network = Id(network)
    };
    try {
      Check(Native.crumple_open(ref options, out handle));
    } catch {
      Dispose();
      throw;
    }
  }

  public void Dispose() {
    Native.crumple_close(handle);
    handle = IntPtr.Zero;
    foreach (IntPtr id in ids.Values) Marshal.FreeHGlobal(id);
    ids.Clear();
  }

  /// Takes in the messages that have arrived; if there are none, it waits for one for at most `seconds`. Returns their number.
  public int Poll(double seconds = 0) { return Check(Native.crumple_poll(Open, (ulong)(1e6 * Math.Max(0, seconds)))); }

  /// Gives a message to a session without a network.
  public void Feed(string key, byte[] message) { Check(Native.crumple_feed(Open, Id(key), message, (UIntPtr)message.Length)); }

  /// The server's time now, s; 0 while the session does not know it.
  public double Time { get { return Native.crumple_time(Open); } }
  public Statistics Statistics {
    get {
      Statistics statistics;
      Native.crumple_statistics(Open, out statistics);
      return statistics;
    }
  }
  /// Simulates a bad link from now on, to test a game on it; new Impairment() makes the link good again.
  public void Impair(Impairment line) { Check(Native.crumple_impair(Open, ref line)); }
  /// Returns false until the first message of health, which comes within a second.
  public bool TryHealth(out Health health) { return Native.crumple_health(Open, out health) == 0; }

  // ---- commands: each returns the tick in which the server did it, or throws Refused

  public ulong Spawn(string car, string asset, Pose pose, bool planar = true, float mass = 0,
                     Float3 inertia = default(Float3), Float3 centerOfMass = default(Float3)) {
    var spawn = new Spawn {
      pose = pose, mass = mass, inertia = inertia, center_of_mass = centerOfMass, planar = planar ? 1 : 0
    };
    ulong ticket;
    Check(Native.crumple_spawn(Open, Id(car), Id(asset), ref spawn, out ticket));
    return Settle(ticket).tick;
  }
  public ulong Despawn(string car) {
    ulong ticket;
    Check(Native.crumple_despawn(Open, Id(car), out ticket));
    return Settle(ticket).tick;
  }
  /// amount: the share of the damage that the server takes away, 0 to 1.
  public ulong Repair(string car, float amount = 1) {
    ulong ticket;
    Check(Native.crumple_repair(Open, Id(car), amount, out ticket));
    return Settle(ticket).tick;
  }
  public ulong SetParameters(string car, Parameters parameters) {
    ulong ticket;
    Check(Native.crumple_set_parameters(Open, Id(car), ref parameters, out ticket));
    return Settle(ticket).tick;
  }
  /// Returns the car's deformation, for Load.
  public byte[] Save(string car) {
    ulong ticket;
    Check(Native.crumple_save(Open, Id(car), out ticket));
    Answer answer = Settle(ticket);
    var state = new byte[(int)answer.state_size];
    if (state.Length > 0) Marshal.Copy(answer.state, state, 0, state.Length);
    return state;
  }
  public ulong Load(string car, byte[] state) {
    ulong ticket;
    Check(Native.crumple_load(Open, Id(car), state, (UIntPtr)state.Length, out ticket));
    return Settle(ticket).tick;
  }
  Answer Settle(ulong ticket) {
    Answer answer;
    Check(Native.crumple_wait(Open, ticket, out answer));
    if (answer.ok == 0) throw new Refused(Native.Text(answer.sentence));
    return answer;
  }

  // ---- host

  /// Takes the bytes of a baked car, so that the server need not send it. Returns its name for Spawn.
  public string AddAsset(byte[] car) {
    var hash = new byte[17];
    Check(Native.crumple_add_asset(Open, car, (UIntPtr)car.Length, hash));
    return Encoding.ASCII.GetString(hash, 0, 16);
  }
  /// Gives a name in the form that CarPose and IsOf take. It is valid until you dispose of the session.
  public IntPtr Id(string text) {
    IntPtr id;
    if (text == null) return IntPtr.Zero;
    if (ids.TryGetValue(text, out id)) return id;
    byte[] bytes = Encoding.UTF8.GetBytes(text + "\0");
    id = Marshal.AllocHGlobal(bytes.Length);
    Marshal.Copy(bytes, 0, id, bytes.Length);
    ids.Add(text, id);
    return id;
  }
  /// Sends all cars of this host. time: the host's clock, s.
  public void PublishPoses(double time, CarPose[] cars, int count) {
    if (count > cars.Length) throw new ArgumentOutOfRangeException("count");
    Check(Native.crumple_publish_poses(Open, time, cars, (UIntPtr)count));
  }
  /// Sends the whole list of this host, which replaces the list before.
  public void PublishObstacles(Obstacle[] obstacles) {
    Check(Native.crumple_publish_obstacles(Open, obstacles, (UIntPtr)obstacles.Length));
  }
  /// Writes reactions that were not taken yet, oldest first. Returns how many it wrote.
  public int TakeReactions(Reaction[] into) {
    return (int)Native.crumple_take_reactions(Open, into, (UIntPtr)into.Length);
  }

  // ---- viewer

  /// From now on the session holds the surface of this car. level 0: in every tick; 1: less often and more coarsely, from afar.
  public void Follow(string car, int level = 0) {
    if (car == null) throw new ArgumentNullException("car");
    Check(Native.crumple_follow(Open, Id(car), level));
  }
  public void FollowAll(int level = 0) { Check(Native.crumple_follow(Open, IntPtr.Zero, level)); }
  public string[] Cars() {
    var ids = new IntPtr[(int)Native.crumple_cars(Open, null, UIntPtr.Zero)];
    Native.crumple_cars(Open, ids, (UIntPtr)ids.Length);
    return Array.ConvertAll(ids, Native.Text);
  }
  /// Returns false while the session holds no surface that is whole and current: keep what you drew.
  public bool TrySurface(string car, out Surface surface) { return Check(Native.crumple_surface(Open, Id(car), out surface)) == 0; }
  /// Returns false while the surface or its mesh is missing.
  public bool Copy(string car, ref Vertices vertices) { return Check(Native.crumple_copy(Open, Id(car), ref vertices)) == 0; }
  /// The parts of a car: wheels, glass, points and so on. False: the asset has not come yet.
  public bool TryParts(string asset, out Parts parts) { return Check(Native.crumple_parts(Open, Id(asset), out parts)) == 0; }
  /// Where the frame of a part is now, in the car's frame. time, false: as in Copy.
  public bool TryPartPose(string car, int part, double time, out Pose pose) {
    return Check(Native.crumple_part_pose(Open, Id(car), (uint)part, time, out pose)) == 0;
  }
  /// Binds your own mesh to a baked car: for Vertices.Mapping. False: the asset has not come yet.
  public bool TryMap(string asset, ref OwnMesh mesh, out uint mapping) {
    return Check(Native.crumple_map(Open, Id(asset), ref mesh, out mapping)) == 0;
  }

  /// Asks the server for the mesh and returns false until it has come: poll and call again.
  public bool TryMesh(string asset, out Mesh mesh) { return Check(Native.crumple_mesh(Open, Id(asset), out mesh)) == 0; }

  IntPtr Open {
    get {
      if (handle == IntPtr.Zero) throw new ObjectDisposedException("Crumple.Session");
      return handle;
    }
  }
  static int Check(int status) {
    if (status < 0) throw new Error(Native.Text(Native.crumple_error()));
    return status;
  }
}

// ---- the header

struct Options {
  public uint version, timeout_ms;
  public IntPtr connect, scene, host, network;
}

struct Spawn {
  public Pose pose;
  public float mass;
  public Float3 inertia, center_of_mass;
  public int planar;
}

struct Answer {
  public int ok;
  public ulong tick;
  public IntPtr sentence, state;
  public UIntPtr state_size;
}

static class Native {
  public const uint Version = 6;  // CRUMPLE_CLIENT_VERSION
  const string library = "crumple_client";

  public static string Text(IntPtr text) {
    if (text == IntPtr.Zero) return "";
    int size = 0;
    while (Marshal.ReadByte(text, size) != 0) ++size;
    var bytes = new byte[size];
    Marshal.Copy(text, bytes, 0, size);
    return Encoding.UTF8.GetString(bytes);
  }
  public static bool Same(IntPtr a, IntPtr b) {
    if (a == IntPtr.Zero || b == IntPtr.Zero) return a == b;
    for (int at = 0;; ++at) {
      byte one = Marshal.ReadByte(a, at);
      if (one != Marshal.ReadByte(b, at)) return false;
      if (one == 0) return true;
    }
  }

  [DllImport(library)] public static extern IntPtr crumple_error();
  [DllImport(library)] public static extern int crumple_open(ref Options options, out IntPtr session);
  [DllImport(library)] public static extern void crumple_close(IntPtr session);
  [DllImport(library)] public static extern int crumple_poll(IntPtr session, ulong timeout_us);
  [DllImport(library)] public static extern void crumple_statistics(IntPtr session, out Statistics statistics);
  [DllImport(library)] public static extern double crumple_time(IntPtr session);
  [DllImport(library)] public static extern int crumple_impair(IntPtr session, ref Impairment line);
  [DllImport(library)] public static extern int crumple_feed(IntPtr session, IntPtr key, byte[] bytes, UIntPtr size);
  [DllImport(library)] public static extern Parameters crumple_keep();
  [DllImport(library)]
  public static extern int crumple_spawn(IntPtr session, IntPtr car, IntPtr asset, ref Spawn spawn, out ulong ticket);
  [DllImport(library)] public static extern int crumple_despawn(IntPtr session, IntPtr car, out ulong ticket);
  [DllImport(library)] public static extern int crumple_repair(IntPtr session, IntPtr car, float amount, out ulong ticket);
  [DllImport(library)]
  public static extern int crumple_set_parameters(IntPtr session, IntPtr car, ref Parameters parameters, out ulong ticket);
  [DllImport(library)] public static extern int crumple_save(IntPtr session, IntPtr car, out ulong ticket);
  [DllImport(library)]
  public static extern int crumple_load(IntPtr session, IntPtr car, byte[] state, UIntPtr size, out ulong ticket);
  [DllImport(library)] public static extern int crumple_wait(IntPtr session, ulong ticket, out Answer answer);
  [DllImport(library)]
  public static extern int crumple_publish_poses(IntPtr session, double time, [In] CarPose[] cars, UIntPtr count);
  [DllImport(library)]
  public static extern int crumple_publish_obstacles(IntPtr session, [In] Obstacle[] obstacles, UIntPtr count);
  [DllImport(library)]
  public static extern UIntPtr crumple_take_reactions(IntPtr session, [Out] Reaction[] reactions, UIntPtr capacity);
  [DllImport(library)] public static extern int crumple_follow(IntPtr session, IntPtr car, int level);
  [DllImport(library)] public static extern UIntPtr crumple_cars(IntPtr session, [Out] IntPtr[] ids, UIntPtr capacity);
  [DllImport(library)] public static extern int crumple_surface(IntPtr session, IntPtr car, out Surface surface);
  [DllImport(library)] public static extern int crumple_copy(IntPtr session, IntPtr car, ref Vertices vertices);
  [DllImport(library)] public static extern int crumple_map(IntPtr session, IntPtr asset, ref OwnMesh mesh, out uint mapping);
  [DllImport(library)] public static extern int crumple_parts(IntPtr session, IntPtr asset, out Parts parts);
  [DllImport(library)] public static extern int crumple_part_pose(IntPtr session, IntPtr car, uint part, double time, out Pose pose);
  [DllImport(library)] public static extern int crumple_mesh(IntPtr session, IntPtr asset, out Mesh mesh);
  [DllImport(library)] public static extern int crumple_add_asset(IntPtr session, byte[] car, UIntPtr size, [Out] byte[] hash);
  [DllImport(library)] public static extern int crumple_health(IntPtr session, out Health health);
}

}  // namespace Crumple
