//! The functions of metrics.h.

use super::*;
use crate::metrics::Metrics;

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
