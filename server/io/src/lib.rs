//! The C functions of transport.h, and every line of unsafe code of the library. In: pointers, checked for NULL and UTF-8 and
//! copied or borrowed for the call; out: statuses, and pointers that live as long as the header says. Handles are boxes.

mod bytes;
mod config;
mod fail;
mod http;
mod inbox;
mod metrics;
mod net;
mod queue;
mod reader;
mod recorder;
mod web;

use fail::{BAD_ARGUMENT, Fail};
use mcap::records::MessageHeader;
use metrics::Metrics;
use net::Net;
use reader::Reader;
use recorder::{Item, Recorder};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ptr;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use web::{Asked, Web};

const OK: c_int = 0;

/// CMake's hash of these sources. Cargo compares a file's time, not its contents, and identifies this crate by its name: without
/// the hash, two checkouts that share a build cache could get each other's library.
const _SOURCES: Option<&str> = option_env!("CRUMPLE_TRANSPORT_SOURCES");

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

fn status<T>(result: Result<T, Fail>, good: impl FnOnce(T) -> c_int) -> c_int {
    match result {
        Ok(value) => good(value),
        Err(fail) => {
            LAST.set(CString::new(fail.sentence.replace('\0', " ")).unwrap_or_default());
            fail.status
        }
    }
}

fn done(result: Result<(), Fail>) -> c_int {
    status(result, |()| OK)
}

fn missing(name: &str) -> Fail {
    Fail::new(BAD_ARGUMENT, format!("{name} is NULL"))
}

/// The caller's pointer, if not NULL, must be valid for the call: that is the contract of each function of the header.
unsafe fn borrow<'a, T>(pointer: *const T, name: &str) -> Result<&'a T, Fail> {
    unsafe { pointer.as_ref() }.ok_or_else(|| missing(name))
}

unsafe fn borrow_mut<'a, T>(pointer: *mut T, name: &str) -> Result<&'a mut T, Fail> {
    unsafe { pointer.as_mut() }.ok_or_else(|| missing(name))
}

unsafe fn text<'a>(pointer: *const c_char, name: &str) -> Result<&'a str, Fail> {
    if pointer.is_null() {
        return Err(missing(name));
    }
    let text = unsafe { CStr::from_ptr(pointer) }.to_str();
    text.map_err(|_| Fail::new(BAD_ARGUMENT, format!("{name} is not valid UTF-8")))
}

unsafe fn text_or<'a>(pointer: *const c_char, default: &'a str, name: &str) -> Result<&'a str, Fail> {
    if pointer.is_null() { Ok(default) } else { unsafe { text(pointer, name) } }
}

unsafe fn bytes<'a>(pointer: *const c_void, size: usize, name: &str) -> Result<&'a [u8], Fail> {
    match (pointer.is_null(), size) {
        (_, 0) => Ok(&[]),
        (true, _) => Err(missing(name)),
        _ => Ok(unsafe { std::slice::from_raw_parts(pointer.cast(), size) }),
    }
}

unsafe fn give<T>(result: Result<T, Fail>, out: *mut *mut T) -> c_int {
    let checked = unsafe { borrow_mut(out, "out") };
    status(result.and_then(|value| checked.map(|out| *out = Box::into_raw(Box::new(value)))), |()| OK)
}

#[unsafe(no_mangle)]
pub extern "C" fn transport_error() -> *const c_char {
    LAST.with_borrow(|sentence| sentence.as_ptr())
}

#[unsafe(no_mangle)]
pub extern "C" fn transport_version() -> *const c_char {
    static LINE: OnceLock<CString> = OnceLock::new();
    let zenoh = zenoh::GIT_VERSION.trim_start_matches('v').trim_end_matches("-release");
    let own = env!("CARGO_PKG_VERSION");
    LINE.get_or_init(|| CString::new(format!("transport {own}, zenoh {zenoh}, mcap {}", mcap::VERSION)).unwrap_or_default())
        .as_ptr()
}

// ---- network ----

/// What the work starts inherits that SIGPIPE is blocked: a peer that hangs up while it is written to ends nobody's program. (TLS
/// writes by writev, which raises it.)
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
        // one that this thread itself raised meanwhile; one that was pending before is not ours
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

/// zenoh drops what it knows of a key part by part, each within the one before, and a key of 64 KB has 32,767 parts: on the 2 MiB that
/// Rust gives a thread, 10,000 end the program. Rust reads this once, before the process's first thread; what the user has set
/// stands.
fn give_threads_room() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        if std::env::var_os("RUST_MIN_STACK").is_none() {
            // SAFETY: as with setenv, no other thread may read the environment in this moment: crumple_client.h says so.
            unsafe { std::env::set_var("RUST_MIN_STACK", (32 << 20).to_string()) };
        }
    });
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
    let subscribe = || unsafe { borrow(net, "net")?.subscribe(text(key, "key_expression")?, depth, longest) };
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
        queries: get(&came.queries),
        queries_refused: get(&came.queries_refused),
        keys: net.key_count() as u64,
        frames_refused: get(&zenoh::REFUSED),
    };
    unsafe { out.write(view) };
}

// ---- metrics ----

#[unsafe(no_mangle)]
pub unsafe extern "C" fn metrics_open(address: *const c_char, out: *mut *mut Metrics) -> c_int {
    if out.is_null() {
        return done(Err(missing("out")));
    }
    give_threads_room();
    let open = || Metrics::open(unsafe { text(address, "address")? });
    unsafe { give(open(), out) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn metrics_address(metrics: *const Metrics) -> *const c_char {
    unsafe { metrics.as_ref() }.map_or(c"".as_ptr(), |metrics| metrics.address().as_ptr())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn metrics_set(metrics: *mut Metrics, page: *const c_char) -> c_int {
    let set = || unsafe {
        borrow(metrics, "metrics")?.set(text(page, "page")?);
        Ok(())
    };
    done(set())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn metrics_close(metrics: *mut Metrics) {
    if !metrics.is_null() {
        drop(unsafe { Box::from_raw(metrics) });
    }
}

// ---- web ----

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_open(address: *const c_char, out: *mut *mut Web) -> c_int {
    if out.is_null() {
        return done(Err(missing("out")));
    }
    give_threads_room();
    let open = || Web::open(unsafe { text(address, "address")? });
    unsafe { give(open(), out) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_address(web: *const Web) -> *const c_char {
    unsafe { web.as_ref() }.map_or(c"".as_ptr(), |web| web.address().as_ptr())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_refused(web: *const Web) -> u64 {
    unsafe { web.as_ref() }.map_or(0, Web::refused)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_page(
    web: *mut Web,
    path: *const c_char,
    media_type: *const c_char,
    data: *const c_void,
    size: usize,
) -> c_int {
    let page = || unsafe {
        borrow(web, "web")?.page(text(path, "path")?, text(media_type, "media_type")?, bytes(data, size, "data")?);
        Ok(())
    };
    done(page())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_set(web: *mut Web, key: *const c_char, data: *const c_void, size: usize) -> c_int {
    let set = || unsafe {
        borrow(web, "web")?.set(text(key, "key")?, bytes(data, size, "data")?);
        Ok(())
    };
    done(set())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_forget(web: *mut Web, prefix: *const c_char) -> c_int {
    let forget = || unsafe {
        borrow(web, "web")?.forget(text(prefix, "prefix")?);
        Ok(())
    };
    done(forget())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_take_requests(web: *mut Web) -> c_int {
    let take = || unsafe {
        borrow(web, "web")?.take_requests();
        Ok(())
    };
    done(take())
}

#[repr(C)]
pub struct WebRequest {
    ticket: u64,
    path: *const c_char,
    data: *const u8,
    size: usize,
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_next(web: *mut Web, out: *mut WebRequest) -> c_int {
    let (Some(web), Some(out)) = (unsafe { web.as_mut() }, unsafe { out.as_mut() }) else {
        return done(Err(missing("web or out")));
    };
    let Some(Asked { ticket, path, data }) = web.next() else { return 0 };
    *out = WebRequest { ticket: *ticket, path: path.as_ptr(), data: data.as_ptr(), size: data.len() };
    1
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_answer(
    web: *mut Web,
    ticket: u64,
    status: u16,
    media_type: *const c_char,
    data: *const c_void,
    size: usize,
) -> c_int {
    let answer =
        || unsafe { borrow(web, "web")?.answer(ticket, status, text(media_type, "media_type")?, bytes(data, size, "data")?) };
    done(answer())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn web_close(web: *mut Web) {
    if !web.is_null() {
        drop(unsafe { Box::from_raw(web) });
    }
}

// ---- recorder ----

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_open(
    path: *const c_char,
    profile: *const c_char,
    library: *const c_char,
    out: *mut *mut Recorder,
) -> c_int {
    if out.is_null() {
        return done(Err(missing("out")));
    }
    give_threads_room();
    let open =
        || unsafe { Recorder::open(text(path, "path")?, text_or(profile, "", "profile")?, text_or(library, "", "library")?) };
    unsafe { give(open(), out) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_schema(
    recorder: *mut Recorder,
    name: *const c_char,
    bfbs: *const c_void,
    size: usize,
) -> c_int {
    let schema = || unsafe {
        borrow(recorder, "recorder")?.schema(text(name, "name")?.to_string(), bytes(bfbs, size, "bfbs")?.to_vec())
    };
    status(schema(), |id| id as c_int)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_channel(recorder: *mut Recorder, topic: *const c_char, schema: c_int) -> c_int {
    let channel = || unsafe {
        let schema = usize::try_from(schema).unwrap_or(usize::MAX);
        borrow(recorder, "recorder")?.channel(text(topic, "topic")?.to_string(), schema)
    };
    status(channel(), |id| id as c_int)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_write(
    recorder: *mut Recorder,
    channel: c_int,
    sequence: u32,
    log_time: u64,
    publish_time: u64,
    data: *const c_void,
    size: usize,
) -> c_int {
    let write = || unsafe {
        let channel = usize::try_from(channel).unwrap_or(usize::MAX);
        let header = MessageHeader { channel_id: 0, sequence, log_time, publish_time };
        borrow(recorder, "recorder")?.write(channel, header, bytes(data, size, "data")?.to_vec())
    };
    done(write())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_attach(
    recorder: *mut Recorder,
    name: *const c_char,
    media_type: *const c_char,
    data: *const c_void,
    size: usize,
) -> c_int {
    let attach = || unsafe {
        let (name, media_type) = (text(name, "name")?.to_string(), text(media_type, "media_type")?.to_string());
        let data = bytes(data, size, "data")?.to_vec();
        borrow(recorder, "recorder")?.push(Item::Attachment { name, media_type, data }, 0)
    };
    done(attach())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_metadata(recorder: *mut Recorder, name: *const c_char, pairs: *const *const c_char) -> c_int {
    let metadata = || {
        let recorder = unsafe { borrow(recorder, "recorder")? };
        let name = unsafe { text(name, "name")? }.to_string();
        let pairs = unsafe { read_pairs(pairs)? };
        let bytes = pairs.iter().map(|(key, value)| key.len() + value.len()).sum();
        recorder.push(Item::Metadata { name, pairs }, bytes)
    };
    done(metadata())
}

unsafe fn read_pairs(pairs: *const *const c_char) -> Result<BTreeMap<String, String>, Fail> {
    let mut read = BTreeMap::new();
    let mut next = unsafe { borrow(pairs, "pairs")? } as *const *const c_char;
    while !unsafe { *next }.is_null() {
        let key = unsafe { text(*next, "key")? };
        let value = unsafe { text(*next.add(1), "the value of the last key")? };
        if read.insert(key.to_string(), value.to_string()).is_some() {
            return Err(Fail::new(BAD_ARGUMENT, format!("the metadata key {key} is given twice")));
        }
        next = unsafe { next.add(2) };
    }
    Ok(read)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_lost(recorder: *const Recorder) -> u64 {
    unsafe { recorder.as_ref() }.map_or(0, Recorder::lost)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_index(recorder: *const Recorder) -> u64 {
    unsafe { recorder.as_ref() }.map_or(0, Recorder::index)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_trouble(recorder: *const Recorder) -> *const c_char {
    let trouble = unsafe { recorder.as_ref() }.and_then(Recorder::trouble);
    trouble.map_or(c"".as_ptr(), |(_, sentence)| sentence.as_ptr())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn recorder_close(recorder: *mut Recorder) -> c_int {
    if recorder.is_null() {
        return done(Err(missing("recorder")));
    }
    done(unsafe { Box::from_raw(recorder) }.close())
}

// ---- reader ----

/// The reader and the arrays of pointers that its metadata is handed out by.
pub struct ReaderHandle {
    reader: Reader,
    pairs: Vec<Vec<*const c_char>>,
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn reader_open(path: *const c_char, out: *mut *mut ReaderHandle) -> c_int {
    if out.is_null() {
        return done(Err(missing("out")));
    }
    let open = || {
        let reader = Reader::open(unsafe { text(path, "path")? })?;
        let pointers = |pairs: &Vec<CString>| pairs.iter().map(|text| text.as_ptr()).chain([ptr::null()]).collect();
        let pairs = reader.metadata().iter().map(|entry| pointers(&entry.pairs)).collect();
        Ok(ReaderHandle { reader, pairs })
    };
    unsafe { give(open(), out) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn reader_close(handle: *mut ReaderHandle) {
    if !handle.is_null() {
        drop(unsafe { Box::from_raw(handle) });
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn reader_cut(handle: *const ReaderHandle) -> c_int {
    unsafe { handle.as_ref() }.map_or(0, |handle| handle.reader.is_cut().into())
}

#[repr(C)]
pub struct ReaderMessage {
    topic: *const c_char,
    schema: *const c_char,
    bfbs: *const u8,
    bfbs_size: usize,
    data: *const u8,
    size: usize,
    sequence: u32,
    log_time_ns: u64,
    publish_time_ns: u64,
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn reader_next(handle: *mut ReaderHandle, out: *mut ReaderMessage) -> c_int {
    let next = || {
        let (handle, out) = unsafe { (borrow_mut(handle, "reader")?, borrow_mut(out, "out")?) };
        let Some(message) = handle.reader.next()? else { return Ok(0) };
        *out = ReaderMessage {
            topic: message.topic.as_ptr(),
            schema: message.schema.name.as_ptr(),
            bfbs: message.schema.data.as_ptr(),
            bfbs_size: message.schema.data.len(),
            data: message.data.as_ptr(),
            size: message.data.len(),
            sequence: message.sequence,
            log_time_ns: message.log_time,
            publish_time_ns: message.publish_time,
        };
        Ok(1)
    };
    status(next(), |more| more)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn reader_rewind(handle: *mut ReaderHandle) -> c_int {
    let rewind = || unsafe { borrow_mut(handle, "reader")? }.reader.rewind();
    done(rewind())
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn reader_attachment(
    handle: *mut ReaderHandle,
    i: u32,
    name: *mut *const c_char,
    media_type: *mut *const c_char,
    data: *mut *const u8,
    size: *mut usize,
) -> c_int {
    let attachment = || unsafe {
        let Some(found) = borrow(handle, "reader")?.reader.attachments().get(i as usize) else { return Ok(0) };
        *borrow_mut(name, "name")? = found.name.as_ptr();
        *borrow_mut(media_type, "media_type")? = found.media_type.as_ptr();
        *borrow_mut(data, "data")? = found.data.as_slice().as_ptr();
        *borrow_mut(size, "size")? = found.data.as_slice().len();
        Ok(1)
    };
    status(attachment(), |found| found)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn reader_metadata(
    handle: *mut ReaderHandle,
    i: u32,
    name: *mut *const c_char,
    pairs: *mut *const *const c_char,
) -> c_int {
    let metadata = || unsafe {
        let handle = borrow(handle, "reader")?;
        let Some(found) = handle.reader.metadata().get(i as usize) else { return Ok(0) };
        *borrow_mut(name, "name")? = found.name.as_ptr();
        *borrow_mut(pairs, "pairs")? = handle.pairs[i as usize].as_ptr();
        Ok(1)
    };
    status(metadata(), |found| found)
}

// The same numbers stand in tests/transport_test.cpp.
const _: () = assert!(size_of::<NetEvent>() == 40 && size_of::<NetStats>() == 96 && size_of::<ReaderMessage>() == 72);
