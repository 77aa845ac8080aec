// One run of the peers' scene (scene.py, play.py) in Jolt's native library: soft body of edge and volume constraints, XPBD.
//   JoltPeer LIBRARY SCENE OUT THREADS ITERATIONS STEPS
// SCENE is the little-endian file that play.py writes; OUT gets the final node positions as float32. Prints one line of JSON:
// version, milliseconds to build, milliseconds of every step. An iteration in Jolt is a sub-step with one pass over all
// constraints.
import com.github.stephengold.joltjni.*;
import com.github.stephengold.joltjni.enumerate.EActivation;
import java.nio.*;
import java.nio.file.*;

public class JoltPeer {
  public static void main(String[] args) throws Exception {
    System.load(args[0]);
    int threads = Integer.parseInt(args[3]), iterations = Integer.parseInt(args[4]), steps = Integer.parseInt(args[5]);
    Jolt.registerDefaultAllocator();
    Jolt.installDefaultAssertCallback();
    Jolt.installDefaultTraceCallback();
    Jolt.newFactory();
    Jolt.registerTypes();

    ByteBuffer in = ByteBuffer.wrap(Files.readAllBytes(Path.of(args[1]))).order(ByteOrder.LITTLE_ENDIAN);
    int nodes = in.getInt(), tets = in.getInt(), edges = in.getInt();
    float dt = in.getFloat(), speed = in.getFloat();
    SoftBodySharedSettings shared = new SoftBodySharedSettings();
    boolean[] pushed = new boolean[nodes];
    for (int i = 0; i < nodes; ++i) {
      Vertex vertex = new Vertex();
      vertex.setPosition(new Vec3(in.getFloat(), in.getFloat(), in.getFloat()));
      vertex.setInvMass(in.getFloat());  // 0: anchored or pushed
      pushed[i] = in.getFloat() != 0;
      shared.addVertex(vertex);
    }
    for (int i = 0; i < edges; ++i) {
      Edge edge = new Edge();
      for (int k = 0; k < 2; ++k) edge.setVertex(k, in.getInt());
      edge.setCompliance(in.getFloat());
      shared.addEdgeConstraint(edge);
    }
    for (int i = 0; i < tets; ++i) {
      Volume volume = new Volume();
      for (int k = 0; k < 4; ++k) volume.setVertex(k, in.getInt());
      volume.setCompliance(in.getFloat());
      shared.addVolumeConstraint(volume);
    }
    long begin = System.nanoTime();
    shared.calculateEdgeLengths();
    shared.calculateVolumeConstraintVolumes();
    shared.optimize();
    double build = (System.nanoTime() - begin) * 1e-6;

    PhysicsSystem system = new PhysicsSystem();
    MapObj2Bp layers = new MapObj2Bp(1, 1).add(0, 0);
    system.init(10, 0, 10, 10, layers, new ObjVsBpFilter(1, 1), new ObjVsObjFilter(1));
    system.setGravity(new Vec3(0, 0, 0));
    SoftBodyCreationSettings settings = new SoftBodyCreationSettings(shared, new RVec3(0, 0, 0), new Quat(), 0);
    settings.setNumIterations(iterations);
    settings.setAllowSleeping(false);
    settings.setUpdatePosition(false);
    settings.setMaxLinearVelocity(1e4f);
    BodyInterface bodies = system.getBodyInterface();
    Body body = bodies.createSoftBody(settings);
    bodies.addBody(body.getId(), EActivation.Activate);
    SoftBodyMotionProperties motion = (SoftBodyMotionProperties) body.getMotionProperties();
    SoftBodyVertex[] vertices = motion.getVertices();

    TempAllocator scratch = new TempAllocatorImpl(256 << 20);
    JobSystem jobs = threads == 1 ? new JobSystemSingleThreaded(Jolt.cMaxPhysicsJobs)
        : new JobSystemThreadPool(Jolt.cMaxPhysicsJobs, Jolt.cMaxPhysicsBarriers, threads - 1);
    StringBuilder times = new StringBuilder();
    Vec3 zero = new Vec3(0, 0, 0), push = new Vec3(-speed, 0, 0);
    for (int step = 0; step < steps; ++step) {
      for (int i = 0; i < nodes; ++i)
        vertices[i].setVelocity(pushed[i] ? push : zero);  // a vertex with inverse mass 0 moves at its velocity
      begin = System.nanoTime();
      int errors = system.update(dt, 1, scratch, jobs);
      times.append(step > 0 ? "," : "").append((System.nanoTime() - begin) * 1e-6);
      if (errors != 0) throw new IllegalStateException("Jolt reports update error " + errors);
    }
    FloatBuffer found = Jolt.newDirectFloatBuffer(3 * nodes);
    motion.putVertexLocations(new RVec3(0, 0, 0), found);
    ByteBuffer out = ByteBuffer.allocate(12 * nodes).order(ByteOrder.LITTLE_ENDIAN);
    for (int i = 0; i < 3 * nodes; ++i) out.putFloat(found.get(i));
    Files.write(Path.of(args[2]), out.array());
    System.out.println("{\"version\":\"" + Jolt.versionString() + "\",\"build_ms\":" + build + ",\"ms\":[" + times + "]}");
    System.out.flush();
    Runtime.getRuntime().halt(0);  // skips the library's own shutdown
  }
}
