//! zenoh's configuration for a session: our values, with their reasons, overridden by the caller's JSON5.

use crate::fail::{BAD_ARGUMENT, Fail, said};
use serde_json::{Value, json};

/// Most bytes of one message, sent or accepted: a baked car of 50,000 nodes has 20 MB (zenoh allows 1 GiB).
pub const MAX_MESSAGE: usize = 64 << 20;
/// room for zenoh's headers
const MAX_HEADERS: usize = 64 << 10;
/// Deepest nesting of brackets: json5 0.4 uses stack for each level, and some 10,000 levels exhaust it. zenoh's keys need 8.
const DEEPEST: usize = 100;

pub fn build(
    mode: &str,
    listen: &[&str],
    connect: &[&str],
    overlay: Option<&str>,
    timeout_ms: u32,
) -> Result<zenoh::Config, Fail> {
    let bad = |sentence: String| Fail::new(BAD_ARGUMENT, sentence);
    match mode {
        "peer" | "router" if listen.is_empty() && connect.is_empty() => {
            return Err(bad(format!("a {mode} needs an endpoint to listen on, such as tcp/127.0.0.1:7447")));
        }
        "client" if connect.is_empty() || !listen.is_empty() => {
            return Err(
                bad("a client needs an endpoint to connect to, such as tcp/127.0.0.1:7447, and listens on none".into()),
            );
        }
        "peer" | "client" | "router" => {}
        other => return Err(bad(format!("mode is \"{other}\"; it must be \"peer\", \"client\" or \"router\""))),
    }
    // Over plain UDP zenoh sends nothing again, so a lost declaration is lost for good. rel=1 is QUIC. Its mixed_rel=1 (samples
    // as datagrams) was tried: with a loss of 2 % the slowest surface took 0.74 s instead of 0.04 s.
    let plain = |it: &&&str| it.starts_with("udp/") && !it.split(['?', ';', '#']).any(|part| part == "rel=1");
    if let Some(endpoint) = listen.iter().chain(connect).find(plain) {
        let at = endpoint.split(['?', '#']).next().unwrap_or_default();
        return Err(bad(format!(
            "{endpoint}: over plain UDP zenoh never resends a lost declaration; write {at}?rel=1 at both ends"
        )));
    }
    let mut config = json!({
        "mode": mode,
        "listen": { "endpoints": listen },
        "connect": {
            "endpoints": connect,
            // after a lost connection: back within a second of the link's return; three small packets a second until then
            "retry": { "period_init_ms": 100, "period_max_ms": 400, "period_increase_factor": 2 },
        },
        // Only endpoints decide who talks to whom; nothing is announced to the local network.
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "transport": {
            // ms; on a link that loses everything an attempt is given up, so that the next one succeeds when the link is back
            "unicast": { "open_timeout": 3000, "accept_timeout": 3000 },
            "link": {
                "tx": {
                    "lease": 3000, // ms until a silent peer counts as gone
                    "queue": {
                        // batches of 64 KiB; with the default of 2, bursts of 40 cars lost samples on a healthy loopback
                        "size": { "control": 16, "real_time": 16, "interactive_high": 16, "interactive_low": 16,
                                  "data_high": 16, "data": 16, "data_low": 16, "background": 16 },
                        // µs; a peer that takes nothing for this long while an answer waits is disconnected (default: 5 s). A
                        // router waits in a thread that also receives; a longer wait makes no room
                        "congestion_control": { "block": { "wait_before_close": if mode == "router" { 100_000 } else { 1_000_000 } } },
                    },
                },
                "rx": { "max_message_size": MAX_MESSAGE + MAX_HEADERS },
            },
        },
    });
    if mode == "client" {
        config["connect"]["timeout_ms"] = json!(timeout_ms);
        config["connect"]["exit_on_failure"] = json!(true);
    }
    if let Some(text) = overlay {
        if depth(text) > DEEPEST {
            return Err(bad(format!(
                "the network configuration nests over {DEEPEST} brackets, and no key of zenoh needs so many; remove some"
            )));
        }
        let laid: Value =
            json5::from_str(text).map_err(|e| bad(format!("the network configuration is not valid JSON5: {e}")))?;
        merge(&mut config, laid);
    }
    zenoh::Config::from_json5(&config.to_string()).map_err(|e| {
        let said = said(&e);
        bad(format!(
            "zenoh refuses the network configuration: {said}; check endpoints (tcp/HOST:PORT) and the names of its keys"
        ))
    })
}

/// Brackets in texts and comments count too: usually they close again there, or are few.
fn depth(text: &str) -> usize {
    let (mut now, mut most) = (0usize, 0);
    for byte in text.bytes() {
        match byte {
            b'[' | b'{' => now += 1,
            b']' | b'}' => now = now.saturating_sub(1),
            _ => {}
        }
        most = most.max(now);
    }
    most
}

/// Objects are merged key by key; anything else is replaced.
fn merge(base: &mut Value, over: Value) {
    match (base, over) {
        (Value::Object(base), Value::Object(over)) => {
            for (key, value) in over {
                merge(base.entry(key).or_insert(Value::Null), value);
            }
        }
        (base, over) => *base = over,
    }
}
