//! Shared by the C functions. Pointers that come in are checked for NULL and UTF-8, and copied or borrowed for the call.
//! Pointers that go out live as long as the header says. Handles are boxes.

mod metrics;
mod net;
mod reader;
mod recorder;
mod web;

use crate::fail::{BAD_ARGUMENT, Fail};
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::sync::OnceLock;

const OK: c_int = 0;

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

pub fn status<T>(result: Result<T, Fail>, good: impl FnOnce(T) -> c_int) -> c_int {
    match result {
        Ok(value) => good(value),
        Err(fail) => {
            LAST.set(CString::new(fail.sentence.replace('\0', " ")).unwrap_or_default());
            fail.status
        }
    }
}

pub fn done(result: Result<(), Fail>) -> c_int {
    status(result, |()| OK)
}

pub fn missing(name: &str) -> Fail {
    Fail::new(BAD_ARGUMENT, format!("{name} is NULL"))
}

/// The caller's pointer, if not NULL, must be valid during the call: each function of the headers requires that.
pub unsafe fn borrow<'a, T>(pointer: *const T, name: &str) -> Result<&'a T, Fail> {
    unsafe { pointer.as_ref() }.ok_or_else(|| missing(name))
}

pub unsafe fn borrow_mut<'a, T>(pointer: *mut T, name: &str) -> Result<&'a mut T, Fail> {
    unsafe { pointer.as_mut() }.ok_or_else(|| missing(name))
}

pub unsafe fn text<'a>(pointer: *const c_char, name: &str) -> Result<&'a str, Fail> {
    if pointer.is_null() {
        return Err(missing(name));
    }
    let text = unsafe { CStr::from_ptr(pointer) }.to_str();
    text.map_err(|_| Fail::new(BAD_ARGUMENT, format!("{name} is not valid UTF-8")))
}

pub unsafe fn text_or<'a>(pointer: *const c_char, default: &'a str, name: &str) -> Result<&'a str, Fail> {
    if pointer.is_null() { Ok(default) } else { unsafe { text(pointer, name) } }
}

pub unsafe fn bytes<'a>(pointer: *const c_void, size: usize, name: &str) -> Result<&'a [u8], Fail> {
    match (pointer.is_null(), size) {
        (_, 0) => Ok(&[]),
        (true, _) => Err(missing(name)),
        _ => Ok(unsafe { std::slice::from_raw_parts(pointer.cast(), size) }),
    }
}

pub unsafe fn give<T>(result: Result<T, Fail>, out: *mut *mut T) -> c_int {
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

/// zenoh drops a key's tree recursively, part by part, and a key of 64 KB has 32,767 parts. On the 2 MiB stack that Rust gives
/// a thread, 10,000 parts crash the program. Rust reads this variable once, before the process's first thread. A value that the
/// user has set stays.
pub fn give_threads_room() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        if std::env::var_os("RUST_MIN_STACK").is_none() {
            // SAFETY: as with setenv, no other thread may read the environment at this moment; crumple_client.h says so.
            unsafe { std::env::set_var("RUST_MIN_STACK", (32 << 20).to_string()) };
        }
    });
}
