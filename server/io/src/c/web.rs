//! The functions of web.h.

use super::*;
use crate::web::{Asked, Web};

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
