// Threads that happen to be free help one car through its colours. A phase is a few microseconds long, too short to wake
// anybody for it: helpers come once a car and tick and watch for phases; the caller goes ahead whether any came or not. Who
// does a piece changes nothing in its result.
#pragma once

#include <tbb/task_group.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

namespace crumple {

class Team {
 public:
  // Asks for helpers from the caller's TBB arena; none come where others have work of their own. On a machine with more to do
  // than processors a helper that is put aside in the middle of a piece holds everybody up: after two such delays the caller
  // goes on alone, for this car and the next 59 that it gathers for.
  void gather();
  void leave();
  ~Team() { leave(); }

  // work(begin, end) for all of [first, last) in pieces of at most `piece`, by everybody; returns when all are done.
  template <class Work>
  void run(uint32_t first, uint32_t last, uint32_t piece, const Work& work) {
    if (!gathered_ || alone_ > 0 || last - first <= piece) {
      if (first < last) work(first, last);
      return;
    }
    first_ = first;
    last_ = last;
    piece_ = piece;
    context_ = &work;
    work_ = [](const void* context, uint32_t begin, uint32_t end) { (*static_cast<const Work*>(context))(begin, end); };
    share((last - first + piece - 1) / piece);
  }

  // The same for work(begin, end, sums), which adds to `Count` numbers. The numbers of the pieces are added in the order of the
  // pieces, whoever did them.
  template <size_t Count, class Work>
  std::array<double, Count> sum(uint32_t last, uint32_t piece, const Work& work) {
    sums_.assign(Count * ((last + piece - 1) / piece), 0.0);
    run(0, last, piece, [&](uint32_t begin, uint32_t end) {
      for (; begin < end; begin += piece) {  // without helpers the whole range comes at once
        work(begin, end - begin < piece ? end : begin + piece, &sums_[Count * (begin / piece)]);
      }
    });
    std::array<double, Count> total = {};
    for (size_t i = 0; i < sums_.size(); ++i) total[i % Count] += sums_[i];
    return total;
  }

 private:
  // A ticket holds everything that tells an open piece from a taken one: phase, pieces, next piece, in 16, 24 and 24 bits.
  static constexpr int bits = 24;
  static uint64_t next(uint64_t ticket) { return ticket & ((uint64_t(1) << bits) - 1); }
  static uint64_t count(uint64_t ticket) { return ticket >> bits & ((uint64_t(1) << bits) - 1); }

  void share(uint64_t pieces);
  bool take();  // and do one piece, if one is open
  void help();

  // Written by the caller before the ticket, read by who has taken a piece of that ticket.
  uint32_t first_ = 0, last_ = 0, piece_ = 1;
  const void* context_ = nullptr;
  void (*work_)(const void*, uint32_t, uint32_t) = nullptr;
  alignas(64) std::atomic<uint64_t> ticket_{0};
  alignas(64) std::atomic<uint64_t> done_{0};
  alignas(64) std::atomic<bool> open_{false};
  uint64_t phase_ = 0;
  bool gathered_ = false;
  int delays_ = 0;  // since gather()
  int alone_ = 0;   // calls of gather() that bring no helpers, since they kept the caller waiting
  std::vector<double> sums_;
  tbb::task_group helpers_;
};

}  // namespace crumple
