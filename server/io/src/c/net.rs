//! The functions of net.h.

use super::*;
use crate::config;
use crate::net::Net;
use std::ptr;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Runs the work with SIGPIPE blocked; threads that it starts inherit that. So a peer that hangs up during a write does not end
/// the program. (TLS writes with writev, which raises the signal.)
#[cfg(target_os = "linux")]
fn with_sigpipe_blocked<T>(work: impl FnOnce() -> T) -> T {
    // SAFETY: all sets are written before they are read, and only this thread's mask changes.
    unsafe {
        let (mut pipe, mut before, mut pending) = (std::mem::zeroed(), std::mem::zeroed(), std::mem::zeroed());
        libc::sigpending(&mut pending);
        let was_pending = libc::sigismember(&pending, libc::SIGPIPE) == 1;
        libc::sigemptyset(&mut pipe);
        libc::sigaddset(&mut pipe, libc::SIGPIPE);
        libc::pthread_sigmask(libc::SIG_BLOCK, &pipe, &mut before);
        let result = work();
        // removes a SIGPIPE that this thread raised meanwhile; one that was pending before is not ours
        let at_once = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        if !was_pending {
            libc::sigtimedwait(&pipe, ptr::null_mut(), &at_once);
        }
        libc::pthread_sigmask(libc::SIG_SETMASK, &before, ptr::null_mut());
        result
    }
}

#[cfg(not(target_os = "linux"))]
fn with_sigpipe_blocked<T>(work: impl FnOnce() -> T) -> T {
    work()
}

fn endpoints(list: &str) -> Vec<&str> {
    list.split(',').map(str::trim).filter(|endpoint| !endpoint.is_empty()).collect()
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_open(
    mode: *const c_char,
    listen: *const c_char,
    connect: *const c_char,
    config: *const c_char,
    timeout_ms: u32,
    out: *mut *mut Net,
) -> c_int {
    let open = || {
        let (listen, connect) = unsafe { (text_or(listen, "", "listen")?, text_or(connect, "", "connect")?) };
        let config = if config.is_null() { None } else { Some(unsafe { text(config, "config")? }) };
        Net::open(unsafe { text(mode, "mode")? }, &endpoints(listen), &endpoints(connect), config, timeout_ms)
    };
    if out.is_null() {
        return done(Err(missing("out")));
    }
    give_threads_room();
    unsafe { give(with_sigpipe_blocked(open), out) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_check(config: *const c_char) -> c_int {
    let endpoint = ["tcp/127.0.0.1:0"];
    let check = || config::build("peer", &endpoint, &[], Some(unsafe { text(config, "config")? }), 0).map(drop);
    done(check())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_endpoint(net: *const Net) -> *const c_char {
    unsafe { net.as_ref() }.map_or(c"".as_ptr(), |net| net.endpoint().as_ptr())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_close(net: *mut Net) {
    if !net.is_null() {
        let net = unsafe { Box::from_raw(net) };
        with_sigpipe_blocked(|| net.close());
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_put(
    net: *mut Net,
    key: *const c_char,
    data: *const c_void,
    size: usize,
    priority: c_int,
) -> c_int {
    let put = || unsafe { borrow(net, "net")?.put(text(key, "key")?, bytes(data, size, "data")?, priority) };
    done(put())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_withdraw(net: *mut Net, prefix: *const c_char) -> c_int {
    let withdraw = || unsafe {
        borrow(net, "net")?.withdraw(text(prefix, "prefix")?);
        Ok(())
    };
    done(withdraw())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_subscribe(net: *mut Net, key: *const c_char, depth: u32, longest: usize) -> c_int {
    let subscribe = || unsafe { borrow(net, "net")?.subscribe(text(key, "key_expression")?, depth, longest, None) };
    done(subscribe())
}

type NetIsNewer = unsafe extern "C" fn(*const u8, usize, *const u8, usize) -> c_int;

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_subscribe_newest(
    net: *mut Net,
    key: *const c_char,
    longest: usize,
    is_newer: Option<NetIsNewer>,
) -> c_int {
    let subscribe = || unsafe {
        let compare = is_newer.ok_or_else(|| missing("is_newer"))?;
        let is_newer = move |a: &[u8], b: &[u8]| compare(a.as_ptr(), a.len(), b.as_ptr(), b.len()) != 0;
        borrow(net, "net")?.subscribe(text(key, "key_expression")?, 0, longest, Some(Box::new(is_newer)))
    };
    done(subscribe())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_prefer(net: *mut Net, keys: *const c_char) -> c_int {
    let prefer = || unsafe { borrow(net, "net")?.prefer(text(keys, "keys")?) };
    done(prefer())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_unsubscribe(net: *mut Net, key: *const c_char) -> c_int {
    let unsubscribe = || unsafe { borrow(net, "net")?.unsubscribe(text(key, "key_expression")?) };
    done(unsubscribe())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_queryable(net: *mut Net, key: *const c_char, depth: u32, longest: usize) -> c_int {
    let declare = || unsafe { borrow(net, "net")?.queryable(text(key, "key_expression")?, depth, longest) };
    done(declare())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_get(
    net: *mut Net,
    key: *const c_char,
    data: *const c_void,
    size: usize,
    timeout_ms: u32,
    ticket: *mut u64,
) -> c_int {
    let get = || unsafe {
        let out = borrow_mut(ticket, "ticket")?;
        *out = borrow(net, "net")?.get(text(key, "key")?, bytes(data, size, "data")?, timeout_ms)?;
        Ok(())
    };
    done(get())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_announce(net: *mut Net, key: *const c_char) -> c_int {
    let announce = || unsafe { borrow(net, "net")?.announce(text(key, "key")?) };
    done(announce())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_retract(net: *mut Net, key: *const c_char) -> c_int {
    let retract = || unsafe { borrow(net, "net")?.retract(text(key, "key")?) };
    done(retract())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_watch(net: *mut Net, key: *const c_char) -> c_int {
    let watch = || unsafe { borrow(net, "net")?.watch(text(key, "key_expression")?) };
    done(watch())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_connected(net: *mut Net) -> c_int {
    status(unsafe { borrow(net, "net") }.map(Net::connected), c_int::from)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_matching(net: *mut Net, key: *const c_char) -> c_int {
    let matching = || unsafe { borrow(net, "net")?.matching(text(key, "key")?) };
    status(matching(), c_int::from)
}

#[repr(C)]
pub struct NetEvent {
    kind: u32,
    failed: u32,
    key: *const c_char,
    data: *const u8,
    size: usize,
    ticket: u64,
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_poll(net: *mut Net, events: *mut NetEvent, capacity: u32, timeout_us: u64) -> c_int {
    let poll = || {
        let net = unsafe { borrow(net, "net")? };
        if events.is_null() || capacity == 0 {
            return Err(missing("room for events"));
        }
        let mut polled = net.polled.lock().unwrap();
        net.poll(&mut polled, capacity.min(i32::MAX as u32) as usize, timeout_us);
        for (i, event) in polled.iter().enumerate() {
            let data = event.data.as_slice();
            let view = NetEvent {
                kind: event.kind as u32,
                failed: event.failed.into(),
                key: event.key.as_ptr(),
                data: data.as_ptr(),
                size: data.len(),
                ticket: event.ticket,
            };
            unsafe { events.add(i).write(view) };
        }
        Ok(polled.len())
    };
    status(poll(), |count| count as c_int)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_reply(net: *mut Net, ticket: u64, data: *const c_void, size: usize, failed: c_int) -> c_int {
    let reply = || unsafe { borrow(net, "net")?.reply(ticket, bytes(data, size, "data")?, failed != 0) };
    done(reply())
}

#[repr(C)]
pub struct NetStats {
    put: u64,
    put_bytes: u64,
    put_dropped: u64,
    received: u64,
    received_bytes: u64,
    received_dropped: u64,
    oversized: u64,
    replaced: u64,
    overtaken: u64,
    queries: u64,
    queries_refused: u64,
    keys: u64,
    frames_refused: u64,
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn net_stats(net: *const Net, out: *mut NetStats) {
    let (Some(net), false) = (unsafe { net.as_ref() }, out.is_null()) else { return };
    let (sent, came) = net.counts();
    let get = |counter: &AtomicU64| counter.load(Relaxed);
    let view = NetStats {
        put: get(&sent.put),
        put_bytes: get(&sent.put_bytes),
        put_dropped: get(&sent.put_dropped),
        received: get(&came.received),
        received_bytes: get(&came.received_bytes),
        received_dropped: get(&came.received_dropped),
        oversized: get(&came.oversized),
        replaced: get(&came.replaced),
        overtaken: get(&came.overtaken),
        queries: get(&came.queries),
        queries_refused: get(&came.queries_refused),
        keys: net.key_count() as u64,
        frames_refused: get(&zenoh::REFUSED),
    };
    unsafe { out.write(view) };
}

// The same numbers stand in tests/io/transport_test.cpp.
const _: () = assert!(size_of::<NetEvent>() == 40 && size_of::<NetStats>() == 104);
