//! An error as the caller sees it: a Status of transport.h and a sentence that names the thing, the fact and the remedy.
//! Nothing in this library panics on bad input, because a panic would end the whole process (panic = "abort").

pub const BAD_ARGUMENT: i32 = -1;
pub const CLOSED: i32 = -2;
pub const DROPPED: i32 = -3;
pub const IO: i32 = -4;
pub const BAD_FILE: i32 = -5;

#[derive(Clone, Debug)]
pub struct Fail {
    pub status: i32,
    pub sentence: String,
}

impl Fail {
    pub fn new(status: i32, sentence: impl Into<String>) -> Fail {
        Fail { status, sentence: sentence.into() }
    }
}

/// An error and all its causes in one line ("I/O error from writing: No space left on device").
pub fn causes(error: &dyn std::error::Error) -> String {
    let mut line = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let text = inner.to_string();
        if !line.contains(&text) {
            line = format!("{line}: {text}");
        }
        cause = inner.source();
    }
    line
}

/// zenoh's message without the positions in its sources.
pub fn said(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let sentences: Vec<_> = text.split(" - Caused by ").map(|it| it.split(" at /").next().unwrap_or(it)).collect();
    sentences.join(": ")
}
