// Runs the program for tests as a user does: server and verbs as processes, hosts and viewers through the client library, real
// Zenoh on loopback. Tests wait for messages, never for a fixed time. A deadline ends each wait.
#pragma once

#include <crumple_client.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <functional>

#include "box_car.h"
#include "paths.h"

namespace crumple {

using Clock = std::chrono::steady_clock;
inline constexpr std::chrono::seconds patience{90};  // for a machine under load with sanitizers on

// A child process whose standard output and error the test reads.
class Process {
 public:
  explicit Process(std::vector<std::string> arguments) {
    int ends[2];
    EXPECT_EQ(pipe(ends), 0);
    arguments.insert(arguments.begin(), program_path());
    child_ = fork();
    if (child_ == 0) {
      dup2(ends[1], STDOUT_FILENO);
      dup2(ends[1], STDERR_FILENO);
      close(ends[0]);
      close(ends[1]);
      std::vector<char*> pointers;
      for (std::string& argument : arguments) pointers.push_back(argument.data());
      pointers.push_back(nullptr);
      execv(pointers[0], pointers.data());
      _exit(127);
    }
    close(ends[1]);
    output_ = ends[0];
  }
  ~Process() {
    if (child_ > 0) {
      kill(child_, SIGKILL);
      wait();
    }
    close(output_);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  // Reads until the text has come. Returns false if the output ended or the deadline passed first.
  bool read_until(const std::string& wanted) {
    const auto deadline = Clock::now() + patience;
    while (text.find(wanted) == std::string::npos) {
      const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Clock::now());
      pollfd waiting{output_, POLLIN, 0};
      if (left.count() <= 0 || ::poll(&waiting, 1, static_cast<int>(left.count())) <= 0) return false;
      char chunk[4096];
      const ssize_t size = read(output_, chunk, sizeof chunk);
      if (size <= 0) return false;
      text.append(chunk, static_cast<size_t>(size));
    }
    return true;
  }
  void send(int signal) const { kill(child_, signal); }
  pid_t id() const { return child_; }
  // Returns the exit code, or minus the signal that ended the process.
  int wait() {
    read_until(std::string(1, '\0'));  // to the end of its output
    int status = 0;
    waitpid(child_, &status, 0);
    child_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }

  std::string text;

 private:
  pid_t child_ = -1;
  int output_ = -1;
};

struct Outcome {
  int code;
  std::string text;
};

inline Outcome run(std::vector<std::string> arguments) {
  Process process(std::move(arguments));
  const int code = process.wait();
  return {code, process.text};
}

// A folder, a car in it, a server and its sessions.
class Program : public testing::Test {
 protected:
  void SetUp() override {
    char name[] = "/tmp/crumple_test_XXXXXX";
    folder = mkdtemp(name);
    car_file = folder / "box.car";
    const auto bytes = box_car_bytes({6, 3, 2});
    std::ofstream(car_file, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    asset = read_car(bytes, "box")->hash;
  }
  void TearDown() override {
    for (Crumple* session : sessions) crumple_close(session);
    server.reset();
    std::filesystem::remove_all(folder);
  }

  std::string path(const char* name) const { return (folder / name).string(); }
  std::string write(const char* name, const std::string& text) const {
    std::ofstream(path(name)) << text;
    return path(name);
  }

  void start(std::vector<std::string> arguments) {
    server = std::make_unique<Process>(std::move(arguments));
    ASSERT_TRUE(server->read_until("\n")) << server->text;
    const size_t at = server->text.find(" at ") + 4;
    ASSERT_NE(at, std::string::npos + 4) << server->text;
    endpoint = server->text.substr(at, server->text.find(',', at) - at);
  }
  void start_server(const std::string& recording, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = {"serve",    "--car",   car_file.string(), "--listen", "tcp/127.0.0.1:0",
                                          "--record", recording, "--threads",       "2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    start(arguments);
  }

  Crumple* open(const char* host = nullptr, const std::string& network = "") {
    const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 30'000, endpoint.c_str(), "main", host, network.c_str()};
    Crumple* session = nullptr;
    EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_OK) << crumple_error();
    if (session) sessions.push_back(session);
    return session;
  }

  // Polls the session until the condition holds. Returns false at the deadline.
  static bool until(Crumple* session, const std::function<bool()>& condition) {
    const auto deadline = Clock::now() + patience;
    while (!condition()) {
      if (Clock::now() > deadline || crumple_poll(session, 100'000) < 0) return false;
    }
    return true;
  }

  static CrumpleAnswer answer(Crumple* session, int status, const uint64_t& ticket) {
    CrumpleAnswer result{};
    EXPECT_EQ(status, CRUMPLE_OK) << crumple_error();
    EXPECT_EQ(crumple_wait(session, ticket, &result), CRUMPLE_OK) << crumple_error();
    return result;
  }

  void spawn(Crumple* session) {
    CrumpleSpawn spawn{};
    spawn.pose.orientation[3] = 1;
    spawn.planar = 1;
    uint64_t ticket = 0;
    const CrumpleAnswer got = answer(session, crumple_spawn(session, "box", asset.c_str(), &spawn, &ticket), ticket);
    EXPECT_TRUE(got.ok) << got.sentence;
  }

  // Drives the car at 10 m/s into a wall 0.3 m before its nose, until it has bounced off and gets no more reactions.
  void crash(Crumple* session) {
    CrumpleObstacle wall{};
    wall.shape = CRUMPLE_BOX;
    wall.size[0] = 1, wall.size[1] = 3, wall.size[2] = 3;
    wall.pose = {{2.25 + 0.3 + 1, 0, 0}, {0, 0, 0, 1}};
    ASSERT_EQ(crumple_publish_obstacles(session, &wall, 1), CRUMPLE_OK) << crumple_error();
    CrumpleCarPose pose{};
    pose.car = "box";
    pose.pose.orientation[3] = 1;
    pose.velocity[0] = 10;
    ASSERT_EQ(crumple_publish_poses(session, 0, &pose, 1), CRUMPLE_OK) << crumple_error();
    uint64_t touched = 0, now = 0;  // ticks; some reactions may be lost on a busy machine
    ASSERT_TRUE(until(session,
                      [&] {
                        CrumpleReaction reaction;
                        while (crumple_take_reactions(session, &reaction, 1) == 1) {
                          now = reaction.tick;
                          if (reaction.contacts > 0) touched = now;
                        }
                        return touched > 0 && now >= touched + 15;
                      }))
        << "no crash, or it does not end; the last touch in tick " << touched << ", the last reaction of tick " << now;
  }

  static uint64_t hash_held(Crumple* session) {
    CrumpleSurface surface{};
    return crumple_surface(session, "box", &surface) == CRUMPLE_OK ? surface.hash : 0;
  }
  static int deepest(Crumple* session) {
    CrumpleSurface surface{};
    if (crumple_surface(session, "box", &surface) != CRUMPLE_OK) return -1;
    int most = 0;
    for (uint32_t i = 0; i < 3 * surface.node_count; ++i) most = std::max(most, std::abs(int{surface.quanta[i]}));
    return most;
  }

  std::filesystem::path folder, car_file;
  std::string asset, endpoint;
  std::unique_ptr<Process> server;
  std::vector<Crumple*> sessions;
};

}  // namespace crumple
