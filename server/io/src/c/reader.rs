//! The functions of mcap.h that read.

use super::*;
use crate::reader::Reader;
use std::ptr;

/// The reader, and the pointer arrays through which it returns its metadata.
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

// The same number stands in tests/io/transport_test.cpp.
const _: () = assert!(size_of::<ReaderMessage>() == 72);
