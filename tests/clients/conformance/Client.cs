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

  static void Main() {
    Session session = Begin();
    string line;
    while ((line = Console.ReadLine()) != null) {
      if (line == "") {
        session.Dispose();
        session = Begin();
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
      }
      Console.WriteLine("}");
    }
    session.Dispose();
  }
}
