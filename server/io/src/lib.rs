//! zenoh sessions, MCAP files, and pages over HTTP, as C functions. c.rs and c/ contain these functions and all unsafe code.
//! This library does not interpret the bytes.

mod bytes;
mod c;
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

/// CMake's hash of these sources. Cargo compares a file's time, not its content, and identifies this crate by its name. Without
/// the hash, two checkouts that share a build cache could get each other's library.
const _SOURCES: Option<&str> = option_env!("CRUMPLE_TRANSPORT_SOURCES");
