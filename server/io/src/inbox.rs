//! Events that have arrived and were not polled yet. zenoh's threads push, one poller takes, both briefly. Every source (a
//! subscription, a queryable, ...) has its own bound: a queue that refuses new events, or one slot per key in which a newer
//! sample replaces the older one (zenoh has no such conflation; a subscriber may say which sample is newer). All sources
//! together have one bound in bytes. Events leave in the order of their arrival.

use crate::bytes::Aligned;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ffi::{CStr, CString};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Condvar, Mutex};
use std::time::Duration;

/// The same values as NetKind in net.h.
#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    Sample = 0,
    Query = 1,
    Reply = 2,
    ReplyEnd = 3,
    Alive = 4,
    Gone = 5,
}

pub struct Event {
    pub kind: Kind,
    pub failed: bool,
    pub key: CString,
    pub data: Aligned,
    pub ticket: u64,
}

pub type SourceId = usize;

/// The answers to this session's own questions.
pub const REPLIES: SourceId = 0;

/// Most keys that may wait in one latest-only subscription: a peer that invents keys must not fill the memory.
const MAX_LATEST_KEYS: usize = 4096;

/// Most bytes of all that waits, four of the longest messages: a peer that sends long messages must not fill the memory either.
const MAX_BYTES: usize = 256 << 20;

/// Whether the first sample is newer than the second.
pub type IsNewer = Box<dyn Fn(&[u8], &[u8]) -> bool + Send>;

struct Source {
    depth: usize,              // 0: latest only
    longest: usize,            // most bytes of a sample or query
    is_newer: Option<IsNewer>, // None: the later arrival is newer
    waiting: usize,
    latest: HashMap<CString, u64>,
}

impl Source {
    fn is_full(&self, key: &CStr) -> bool {
        match self.depth {
            0 => self.latest.len() >= MAX_LATEST_KEYS && !self.latest.contains_key(key),
            depth => self.waiting >= depth,
        }
    }
}

#[derive(Default)]
struct State {
    next: u64,
    waiting: BTreeMap<u64, (SourceId, Event)>,
    bytes: usize,
    preferred: HashSet<CString>,
    sources: Vec<Source>,
    free: Vec<SourceId>, // returned ids; their remaining events are taken as usual
}

impl State {
    fn is_full(&self, source: SourceId, key: &CStr, size: usize) -> bool {
        if self.sources[source].depth == 0 && self.preferred.contains(key) {
            return false;
        }
        self.sources[source].is_full(key) || self.bytes + size > MAX_BYTES
    }

    /// Whether a sample of the same key waits and this one is not newer.
    fn is_overtaken(&self, source: SourceId, event: &Event) -> bool {
        let source = &self.sources[source];
        let (Some(is_newer), Some(number)) = (&source.is_newer, source.latest.get(&event.key)) else { return false };
        !is_newer(event.data.as_slice(), self.waiting[number].1.data.as_slice())
    }
}

impl Event {
    fn size(&self) -> usize {
        self.data.as_slice().len()
    }
}

/// Counts of events by their fate. A sample or query is counted before the poller can see it.
#[derive(Default)]
pub struct Counts {
    pub received: AtomicU64,
    pub received_bytes: AtomicU64,
    pub received_dropped: AtomicU64, // samples, answers and reports
    pub oversized: AtomicU64,
    pub replaced: AtomicU64,
    pub overtaken: AtomicU64, // not newer than the sample of their key that waits
    pub queries: AtomicU64,
    pub queries_refused: AtomicU64,
}

impl Counts {
    pub fn refused(&self, kind: Kind) {
        let counter = if kind == Kind::Query { &self.queries_refused } else { &self.received_dropped };
        counter.fetch_add(1, Relaxed);
    }

    fn taken(&self, event: &Event) {
        match event.kind {
            Kind::Sample => {
                self.received.fetch_add(1, Relaxed);
                self.received_bytes.fetch_add(event.size() as u64, Relaxed);
            }
            Kind::Query => _ = self.queries.fetch_add(1, Relaxed),
            _ => {}
        }
    }
}

#[derive(Default)]
pub struct Inbox {
    pub counts: Counts,
    state: Mutex<State>,
    arrived: Condvar,
}

impl Inbox {
    pub fn new(max_replies: usize) -> Inbox {
        let inbox = Inbox::default();
        inbox.add_source(max_replies, usize::MAX, None); // REPLIES
        inbox
    }

    pub fn add_source(&self, depth: usize, longest: usize, is_newer: Option<IsNewer>) -> SourceId {
        let mut state = self.state.lock().unwrap();
        if let Some(source) = state.free.pop() {
            let place = &mut state.sources[source];
            (place.depth, place.longest, place.is_newer) = (depth, longest, is_newer);
            return source;
        }
        state.sources.push(Source { depth, longest, is_newer, waiting: 0, latest: HashMap::new() });
        state.sources.len() - 1
    }

    /// Replaces the previous list.
    pub fn prefer(&self, keys: HashSet<CString>) {
        self.state.lock().unwrap().preferred = keys;
    }

    pub fn free_source(&self, source: SourceId) {
        self.state.lock().unwrap().free.push(source);
    }

    /// Whether an event is too long for its source; if so, counts it. Called before a copy is made.
    pub fn is_oversized(&self, source: SourceId, size: usize) -> bool {
        let oversized = size > self.state.lock().unwrap().sources[source].longest;
        if oversized {
            self.counts.oversized.fetch_add(1, Relaxed);
        }
        oversized
    }

    /// Whether an event would be refused; if so, counts it. Called before a copy is made.
    pub fn refuses(&self, source: SourceId, kind: Kind, key: &CStr, size: usize) -> bool {
        let full = self.state.lock().unwrap().is_full(source, key, size);
        if full {
            self.counts.refused(kind);
        }
        full
    }

    /// Returns false if the event was refused and counted.
    pub fn push(&self, source: SourceId, event: Event) -> bool {
        let mut state = self.state.lock().unwrap();
        // The end of the answers always passes: the asker waits for it, and there is only one per question.
        if state.is_full(source, &event.key, event.size()) && event.kind != Kind::ReplyEnd {
            self.counts.refused(event.kind);
            return false;
        }
        if state.is_overtaken(source, &event) {
            self.counts.overtaken.fetch_add(1, Relaxed);
            return false;
        }
        let number = state.next;
        let mut older = None;
        if state.sources[source].depth == 0 {
            older = state.sources[source].latest.insert(event.key.clone(), number);
        }
        state.next += 1;
        let replaced = older.and_then(|older| state.waiting.remove(&older));
        match &replaced {
            Some((_, event)) => {
                self.counts.replaced.fetch_add(1, Relaxed);
                state.bytes -= event.size();
            }
            None => state.sources[source].waiting += 1,
        }
        self.counts.taken(&event);
        state.bytes += event.size();
        state.waiting.insert(number, (source, event));
        drop(state);
        self.arrived.notify_one();
        true // `replaced` is freed here, outside the lock
    }

    /// Waits for an event, then appends up to `most` events to `out`.
    pub fn take(&self, most: usize, timeout: Duration, out: &mut Vec<Event>) {
        let mut state = self.state.lock().unwrap();
        if !timeout.is_zero() {
            let idle = |state: &mut State| state.waiting.is_empty();
            state = self.arrived.wait_timeout_while(state, timeout, idle).unwrap().0;
        }
        while out.len() < most {
            let Some((_, (source, event))) = state.waiting.pop_first() else { break };
            state.bytes -= event.size();
            let source = &mut state.sources[source];
            source.waiting -= 1;
            if source.depth == 0 {
                source.latest.remove(&event.key);
            }
            out.push(event);
        }
    }
}
