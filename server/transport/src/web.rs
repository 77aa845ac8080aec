//! Pages over HTTP and one WebSocket, /live, for browsers. The owner sets what stands under a path and, apart from that, a state: bytes
//! under keys. Every browser is brought up to the state again and again: it gets what was set since the last batch that it got, each
//! key once, and the next batch when it has answered, so that a slow or frozen one costs no more than the batches it has not answered
//! yet, and finds the present when it goes on. What a browser says there beside that is not looked at. Where the owner takes requests
//! (POST), they wait for it in a bounded line.

use crate::fail::{BAD_ARGUMENT, Fail, IO};
use axum::Router;
use axum::body::{Bytes, to_bytes};
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, StatusCode, Uri, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::ffi::CString;
use std::net::IpAddr;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::{oneshot, watch};
use tokio::time::{sleep, timeout};

/// Batches that a browser may have unanswered: enough for 60 a second over a line of 60 ms there and back.
const WINDOW: usize = 4;
/// A batch waits so long for what else belongs to its tick.
const GATHER: Duration = Duration::from_millis(4);
/// A browser that answers nothing for so long is let go; its page comes back by itself when it can.
const PATIENCE: Duration = Duration::from_secs(30);
const MAX_BROWSERS: usize = 256;
/// Of a message of a browser: answers are empty.
const MAX_ANSWER: usize = 1024;

/// Of what is posted: a regions file of 8,000 dabs.
const MAX_REQUEST: usize = 1 << 20;
const MAX_WAITING: usize = 64;
/// Until a request must have been answered.
const ANSWERED: Duration = Duration::from_secs(30);

pub struct Asked {
    pub ticket: u64,
    pub path: CString,
    pub data: Bytes,
}

/// Requests that nobody has taken, and whoever waits for their answers, by ticket.
#[derive(Default)]
struct Requests {
    last: u64,
    line: VecDeque<Asked>,
    answers: HashMap<u64, oneshot::Sender<Response>>,
}

/// A browser that waits; one that goes leaves nothing behind.
struct Waiting {
    shared: Arc<Shared>,
    ticket: u64,
}

impl Drop for Waiting {
    fn drop(&mut self) {
        if let Some(requests) = self.shared.requests.lock().unwrap().as_mut() {
            requests.answers.remove(&self.ticket);
            requests.line.retain(|asked| asked.ticket != self.ticket);
        }
    }
}

struct Slot {
    key: Box<str>,
    data: Bytes,
    since: Instant,
}

/// By the number of their setting, so that what is newer than a number is a range.
#[derive(Default)]
struct Slots {
    last: u64,
    slots: BTreeMap<u64, Slot>,
    numbers: HashMap<Box<str>, u64>,
}

struct Page {
    media_type: String,
    data: Bytes,
}

struct Shared {
    pages: Mutex<HashMap<String, Page>>,
    state: Mutex<Slots>,
    changed: watch::Sender<u64>,       // the last number
    requests: Mutex<Option<Requests>>, // None: nobody takes them
    browsers: AtomicUsize,
    loopback: bool, // reached from this machine only
}

pub struct Web {
    shared: Arc<Shared>,
    taken: Option<Asked>, // the last
    address: CString,
    runtime: Option<Runtime>,
}

impl Web {
    pub fn open(address: &str) -> Result<Web, Fail> {
        if !address.contains(':') {
            return Err(Fail::new(BAD_ARGUMENT, format!("page at {address}: give HOST:PORT, such as 127.0.0.1:8080")));
        }
        let cannot = |e: std::io::Error| {
            Fail::new(IO, format!("cannot serve a page at {address}: is the port free and the address this machine's? ({e})"))
        };
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).thread_name("web").enable_all().build();
        let runtime = runtime.map_err(cannot)?;
        let listener = runtime.block_on(TcpListener::bind(address)).map_err(cannot)?;
        let local = listener.local_addr().map_err(cannot)?;
        let shared = Arc::new(Shared {
            pages: Mutex::default(),
            state: Mutex::default(),
            changed: watch::Sender::new(0),
            requests: Mutex::default(),
            browsers: AtomicUsize::new(0),
            loopback: local.ip().is_loopback(),
        });
        let router = Router::new()
            .route("/live", get(upgrade))
            .fallback(get(page).post(request))
            .layer(middleware::from_fn_with_state(shared.clone(), same_site))
            .with_state(shared.clone());
        runtime.spawn(async move { axum::serve(listener, router).await });
        Ok(Web { shared, taken: None, address: CString::new(local.to_string()).unwrap_or_default(), runtime: Some(runtime) })
    }

    pub fn address(&self) -> &CString {
        &self.address
    }

    pub fn page(&self, path: &str, media_type: &str, data: &[u8]) {
        let page = Page { media_type: media_type.to_string(), data: Bytes::copy_from_slice(data) };
        self.shared.pages.lock().unwrap().insert(path.to_string(), page);
    }

    pub fn set(&self, key: &str, data: &[u8]) {
        let slot = Slot { key: key.into(), data: Bytes::copy_from_slice(data), since: Instant::now() };
        let mut state = self.shared.state.lock().unwrap();
        state.last += 1;
        let number = state.last;
        if let Some(older) = state.numbers.insert(key.into(), number) {
            state.slots.remove(&older);
        }
        state.slots.insert(number, slot);
        drop(state);
        self.shared.changed.send_replace(number);
    }

    pub fn take_requests(&self) {
        self.shared.requests.lock().unwrap().get_or_insert_default();
    }

    pub fn next(&mut self) -> Option<&Asked> {
        self.taken = self.shared.requests.lock().unwrap().as_mut()?.line.pop_front();
        self.taken.as_ref()
    }

    /// Whoever is gone needs no answer.
    pub fn answer(&self, ticket: u64, status: u16, media_type: &str, data: &[u8]) -> Result<(), Fail> {
        let status = StatusCode::from_u16(status).map_err(|e| Fail::new(BAD_ARGUMENT, format!("status {status}: {e}")))?;
        let head = [(header::CONTENT_TYPE, media_type.to_string())];
        let response = (status, head, Bytes::copy_from_slice(data)).into_response();
        if let Some(waits) = self.shared.requests.lock().unwrap().as_mut().and_then(|all| all.answers.remove(&ticket)) {
            _ = waits.send(response);
        }
        Ok(())
    }

    pub fn forget(&self, prefix: &str) {
        self.shared.pages.lock().unwrap().retain(|path, _| !path.starts_with(prefix));
        let mut state = self.shared.state.lock().unwrap();
        state.numbers.retain(|key, _| !key.starts_with(prefix));
        state.slots.retain(|_, slot| !slot.key.starts_with(prefix));
    }
}

impl Drop for Web {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// A page of another site may be in the same browser, and its name may lead here: neither is answered.
async fn same_site(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    if is_same_site(request.headers(), shared.loopback, request.method() == Method::POST) {
        return next.run(request).await;
    }
    (StatusCode::FORBIDDEN, "only the page that is served here may ask here\n").into_response()
}

/// A name of the public network could be led here by whoever owns it: it may see what is public anyway, and command nothing.
fn is_same_site(headers: &HeaderMap, loopback: bool, commands: bool) -> bool {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    let host = text(header::HOST).unwrap_or_default();
    let name = host.rsplit_once(':').map_or(host, |(name, port)| if port.ends_with(']') { host } else { name });
    let own = ["localhost", "127.0.0.1", "[::1]"].contains(&name);
    let same = |origin: &str| origin.split_once("://").is_some_and(|(_, from)| from == host);
    let bare = name.trim_matches(['[', ']']);
    let local = bare.parse::<IpAddr>().is_ok() || !bare.contains('.') || bare.ends_with(".local");
    (own || (!loopback && (local || !commands))) && text(header::ORIGIN).is_none_or(same)
}

async fn page(State(shared): State<Arc<Shared>>, uri: Uri) -> Response {
    match shared.pages.lock().unwrap().get(uri.path()) {
        Some(page) => {
            let head = [(header::CONTENT_TYPE, page.media_type.clone()), (header::CACHE_CONTROL, "no-cache".into())];
            (head, page.data.clone()).into_response()
        }
        None => (StatusCode::NOT_FOUND, "not here (yet)\n").into_response(),
    }
}

async fn request(State(shared): State<Arc<Shared>>, request: Request) -> Response {
    const BUSY: &str = "too many requests wait here: try again later\n";
    let path = CString::new(request.uri().path()).unwrap_or_default();
    if shared.requests.lock().unwrap().is_none() {
        return (StatusCode::FORBIDDEN, "this page only shows the scene\n").into_response();
    }
    let Ok(body) = timeout(ANSWERED, to_bytes(request.into_body(), MAX_REQUEST)).await else {
        return (StatusCode::REQUEST_TIMEOUT, "the request did not arrive\n").into_response();
    };
    let Ok(data) = body else {
        return (StatusCode::PAYLOAD_TOO_LARGE, "more than the 1 MiB that a request may have\n").into_response();
    };
    let (waiting, answer) = {
        let mut all = shared.requests.lock().unwrap();
        let Some(requests) = all.as_mut().filter(|requests| requests.answers.len() < MAX_WAITING) else {
            return (StatusCode::SERVICE_UNAVAILABLE, BUSY).into_response();
        };
        requests.last += 1;
        let (ticket, (sender, answer)) = (requests.last, oneshot::channel());
        requests.answers.insert(ticket, sender);
        requests.line.push_back(Asked { ticket, path, data });
        (Waiting { shared: shared.clone(), ticket }, answer)
    };
    let answered = timeout(ANSWERED, answer).await;
    drop(waiting);
    match answered {
        Ok(Ok(response)) => response,
        _ => (StatusCode::GATEWAY_TIMEOUT, "no answer came in time\n").into_response(),
    }
}

async fn upgrade(State(shared): State<Arc<Shared>>, upgrade: WebSocketUpgrade) -> Response {
    if shared.browsers.load(Relaxed) >= MAX_BROWSERS {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many browsers watch here\n").into_response();
    }
    upgrade.max_message_size(MAX_ANSWER).on_upgrade(|socket| async move {
        shared.browsers.fetch_add(1, Relaxed);
        live(socket, &shared).await;
        shared.browsers.fetch_sub(1, Relaxed);
    })
}

/// Until the browser goes or is let go.
async fn live(mut socket: WebSocket, shared: &Shared) {
    let mut changed = shared.changed.subscribe();
    changed.mark_changed(); // all there is, at once
    let (mut sent, mut unanswered) = (0, 0);
    loop {
        tokio::select! {
            came = changed.changed(), if unanswered < WINDOW => {
                if came.is_err() {
                    return;
                }
                sleep(GATHER).await;
                changed.mark_unchanged();
                let Some((batch, last)) = batch(&shared.state.lock().unwrap(), sent) else { continue };
                if !matches!(timeout(PATIENCE, socket.send(Message::Binary(batch))).await, Ok(Ok(()))) {
                    return;
                }
                sent = last;
                unanswered += 1;
            }
            answer = socket.recv() => match answer {
                Some(Ok(Message::Binary(_))) => unanswered = unanswered.saturating_sub(1),
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                _ => return,
            },
            _ = sleep(PATIENCE), if unanswered > 0 => return,
        }
    }
}

/// What was set after number `sent`, in that order, and the last number. transport.h says how it is laid out.
fn batch(state: &Slots, sent: u64) -> Option<(Bytes, u64)> {
    let slots = || state.slots.range(sent + 1..).map(|(_, slot)| slot);
    let size = slots().map(|slot| 10 + slot.key.len() + slot.data.len()).sum();
    let mut bytes = Vec::with_capacity(size);
    for slot in slots() {
        bytes.extend_from_slice(&(slot.key.len() as u16).to_le_bytes());
        bytes.extend_from_slice(&(slot.data.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&(slot.since.elapsed().as_millis() as u32).to_le_bytes());
        bytes.extend_from_slice(slot.key.as_bytes());
        bytes.extend_from_slice(&slot.data);
    }
    (size > 0).then(|| (bytes.into(), state.last))
}
