//! The functions of mcap.h that write.

use super::*;
use crate::recorder::{Item, Recorder};
use mcap::records::MessageHeader;
use std::collections::BTreeMap;

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
