// Idle threads help to solve one car, colour by colour. A phase takes a few microseconds, too short to wake a thread for it.
// Helpers therefore join once per car and tick and poll for phases, and the caller starts whether or not any have come. The
// result does not depend on which thread does a piece.
#pragma once

#include <tbb/task_group.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

namespace crumple {

class Team {
 public:
  // Asks for helpers from the caller's TBB arena; none come if all threads are busy. On an overloaded machine the system may
  // suspend a helper in the middle of a piece, and everybody waits for it. After two such delays the caller works alone for
  // this car and for the next 59 calls of gather().
  void gather();
  void leave();
  ~Team() { leave(); }

  // Calls work(begin, end) on pieces of [first, last) of at most `piece` each, on all threads. Returns when all are done.
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

  // The same for work(begin, end, sums), which adds to `Count` numbers. The sums of the pieces are added in the order of the
  // pieces, so the result does not depend on threads.
  template <size_t Count, class Work>
  std::array<double, Count> sum(uint32_t last, uint32_t piece, const Work& work) {
    sums_.assign(Count * ((last + piece - 1) / piece), 0.0);
    run(0, last, piece, [&](uint32_t begin, uint32_t end) {
      for (; begin < end; begin += piece) {  // without helpers the whole range comes in one call
        work(begin, end - begin < piece ? end : begin + piece, &sums_[Count * (begin / piece)]);
      }
    });
    std::array<double, Count> total = {};
    for (size_t i = 0; i < sums_.size(); ++i) total[i % Count] += sums_[i];
    return total;
  }

 private:
  // A ticket packs phase, number of pieces and next piece in 16, 24 and 24 bits, so one read tells whether a piece is open.
  static constexpr int bits = 24;
  static uint64_t next(uint64_t ticket) { return ticket & ((uint64_t(1) << bits) - 1); }
  static uint64_t count(uint64_t ticket) { return ticket >> bits & ((uint64_t(1) << bits) - 1); }

  void share(uint64_t pieces);
  bool take();  // takes and does one piece, if one is open
  void help();

  // The caller writes these before the ticket. A thread reads them after it has taken a piece of that ticket.
  uint32_t first_ = 0, last_ = 0, piece_ = 1;
  const void* context_ = nullptr;
  void (*work_)(const void*, uint32_t, uint32_t) = nullptr;
  alignas(64) std::atomic<uint64_t> ticket_{0};
  alignas(64) std::atomic<uint64_t> done_{0};
  alignas(64) std::atomic<bool> open_{false};
  uint64_t phase_ = 0;
  bool gathered_ = false;
  int delays_ = 0;  // since gather()
  int alone_ = 0;   // how many calls of gather() still bring no helpers, after too many delays
  std::vector<double> sums_;
  tbb::task_group helpers_;
};

}  // namespace crumple
