//! A bounded queue from any thread to one or a few worker threads. Items have a size and leave in order. Pushing never waits: a
//! full queue refuses the item, and the caller counts it.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex};
use std::time::Duration;

pub struct Queue<T> {
    state: Mutex<State<T>>,
    changed: Condvar,
    max_bytes: usize,
    max_items: usize,
}

struct State<T> {
    items: VecDeque<(T, usize)>,
    bytes: usize,
    popping: usize, // threads that wait for an item
    closed: bool,
}

pub enum Refused {
    Full,
    Closed,
}

pub enum Next<T> {
    Item(T),
    TimedOut,
    Closed,
}

impl<T> Queue<T> {
    pub fn new(max_bytes: usize, max_items: usize) -> Queue<T> {
        let state = State { items: VecDeque::new(), bytes: 0, popping: 0, closed: false };
        Queue { state: Mutex::new(state), changed: Condvar::new(), max_bytes, max_items }
    }

    /// Takes the item unless the bound is already reached; so an empty queue takes even an item larger than the bound. A refused
    /// item comes back.
    pub fn push(&self, item: T, bytes: usize) -> Result<(), (Refused, T)> {
        let mut state = self.state.lock().unwrap();
        if state.closed {
            return Err((Refused::Closed, item));
        }
        if state.bytes >= self.max_bytes || state.items.len() >= self.max_items {
            return Err((Refused::Full, item));
        }
        state.bytes += bytes;
        state.items.push_back((item, bytes));
        let wakes = state.popping > 0;
        drop(state);
        if wakes {
            self.changed.notify_one();
        }
        Ok(())
    }

    /// Whether more items than threads wait.
    pub fn is_behind(&self) -> bool {
        let state = self.state.lock().unwrap();
        state.items.len() > state.popping
    }

    /// The next item; after close() the remaining items, then Closed.
    pub fn pop(&self, timeout: Option<Duration>) -> Next<T> {
        let mut state = self.state.lock().unwrap();
        let idle = |state: &mut State<T>| state.items.is_empty() && !state.closed;
        state.popping += 1;
        state = match timeout {
            None => self.changed.wait_while(state, idle).unwrap(),
            Some(timeout) => self.changed.wait_timeout_while(state, timeout, idle).unwrap().0,
        };
        state.popping -= 1;
        match state.items.pop_front() {
            Some((item, bytes)) => {
                state.bytes -= bytes;
                Next::Item(item)
            }
            None if state.closed => Next::Closed,
            None => Next::TimedOut,
        }
    }

    pub fn close(&self) {
        self.state.lock().unwrap().closed = true;
        self.changed.notify_all();
    }
}
