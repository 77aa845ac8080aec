//! Pages over HTTP and one WebSocket, /live, for browsers. The caller sets pages by path and, separately, a state: bytes under
//! keys. Every browser gets the changes of the state in batches. A batch holds everything that was set since the browser's last
//! one, each key once. The browser answers each batch and gets no more while too many are unanswered. So a slow or frozen
//! browser costs only its unanswered batches, and later continues with the present state. A large state is sent in several
//! batches. Other messages of a browser are ignored. If the caller takes requests (POST), they wait for it in a bounded queue.

use crate::fail::{BAD_ARGUMENT, Fail};
use crate::http::{Door, PATIENCE, Place, Places};
use axum::Router;
use axum::body::{Bytes, to_bytes};
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Extension, Request, State};
use axum::http::{HeaderMap, Method, StatusCode, Uri, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::SinkExt;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::ffi::CString;
use std::net::IpAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::{oneshot, watch};
use tokio::time::{Instant, sleep, sleep_until, timeout};

/// Most unanswered batches of a browser: enough for 60 a second over a line with a round trip of 60 ms.
const WINDOW: usize = 4;
/// How long a batch waits for more data of its tick.
const GATHER: Duration = Duration::from_millis(4);
/// Bytes of a batch, or one slot if that is longer. For a browser that does not read, this much is copied twice; the rest that
/// it waits for is shared with the state.
const MAX_BATCH: usize = 256 << 10;
/// Most browsers at a time, half of them from one address.
const MAX_BROWSERS: usize = 256;
/// Most connections at a time: the browsers', and as many for pages.
const MAX_CONNECTIONS: usize = 2 * MAX_BROWSERS;
/// Most bytes of a browser's message, and of one read: answers are empty.
const MAX_ANSWER: usize = 1024;

/// Most bytes of a POST request: a regions file of 8,000 dabs.
const MAX_REQUEST: usize = 1 << 20;
/// Most requests that arrive or wait at a time, half of them from one address.
const MAX_WAITING: usize = 64;
/// Time in which a request must arrive, and in which it must be answered.
const ANSWERED: Duration = Duration::from_secs(30);

pub struct Asked {
    pub ticket: u64,
    pub path: CString,
    pub data: Bytes,
}

/// Requests that the caller has not taken, and the browsers that wait for answers, by ticket.
#[derive(Default)]
struct Requests {
    last: u64,
    line: VecDeque<Asked>,
    answers: HashMap<u64, (IpAddr, oneshot::Sender<Response>)>,
}

impl Requests {
    fn has_room(&self, from: IpAddr) -> bool {
        let of_it = self.answers.values().filter(|(other, _)| *other == from).count();
        self.answers.len() < MAX_WAITING && of_it < MAX_WAITING / 2
    }
}

/// A browser that waits for an answer. When it disconnects, its request is removed.
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

#[derive(Clone)]
struct Slot {
    key: Arc<str>,
    data: Bytes,
    since: Instant,
}

/// Slots by the number of their setting, so that all slots newer than a number are a range.
#[derive(Default)]
struct Slots {
    last: u64,
    slots: BTreeMap<u64, Slot>,
    numbers: HashMap<Arc<str>, u64>,
}

impl Slots {
    /// The slots that were set after number `sent`, in order, and the last number.
    fn since(&self, sent: u64) -> (VecDeque<Slot>, u64) {
        (self.slots.range(sent + 1..).map(|(_, slot)| slot.clone()).collect(), self.last)
    }
}

struct Page {
    media_type: String,
    data: Bytes,
}

struct Shared {
    pages: Mutex<HashMap<String, Page>>,
    state: Mutex<Slots>,
    changed: watch::Sender<u64>,       // the last number of a setting
    requests: Mutex<Option<Requests>>, // None: the caller takes no requests
    places: Arc<Places>,
    loopback: bool, // reachable from this machine only
}

pub struct Web {
    shared: Arc<Shared>,
    taken: Option<Asked>, // the last request from next()
    door: Door,
}

impl Web {
    pub fn open(address: &str) -> Result<Web, Fail> {
        let mut door = Door::open("a page", address, MAX_CONNECTIONS)?;
        let shared = Arc::new(Shared {
            pages: Mutex::default(),
            state: Mutex::default(),
            changed: watch::Sender::new(0),
            requests: Mutex::default(),
            places: door.places.clone(),
            loopback: door.local.ip().is_loopback(),
        });
        let router = Router::new()
            .route("/live", get(upgrade))
            .fallback(get(page).post(request))
            .layer(middleware::from_fn_with_state(shared.clone(), same_site))
            .with_state(shared.clone());
        door.serve(router);
        Ok(Web { shared, taken: None, door })
    }

    pub fn address(&self) -> &CString {
        self.door.address()
    }

    pub fn refused(&self) -> u64 {
        self.shared.places.refused()
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
        if let Some(older) = state.numbers.insert(slot.key.clone(), number) {
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

    /// Does nothing if the browser is gone.
    pub fn answer(&self, ticket: u64, status: u16, media_type: &str, data: &[u8]) -> Result<(), Fail> {
        let status = StatusCode::from_u16(status).map_err(|e| Fail::new(BAD_ARGUMENT, format!("status {status}: {e}")))?;
        let head = [(header::CONTENT_TYPE, media_type.to_string())];
        let response = (status, head, Bytes::copy_from_slice(data)).into_response();
        if let Some((_, waits)) = self.shared.requests.lock().unwrap().as_mut().and_then(|all| all.answers.remove(&ticket)) {
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

/// Refuses pages of other sites in the same browser, and foreign host names that lead here.
async fn same_site(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    if is_same_site(request.headers(), shared.loopback, request.method() == Method::POST) {
        return next.run(request).await;
    }
    (StatusCode::FORBIDDEN, "only the page of this address may send requests to it\n").into_response()
}

/// The owner of a public host name could let it lead here. Such a page may see what is public anyway, but may command nothing.
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
        None => (StatusCode::NOT_FOUND, "nothing is at this path, or not yet\n").into_response(),
    }
}

async fn request(State(shared): State<Arc<Shared>>, Extension(place): Extension<Arc<Place>>, request: Request) -> Response {
    const BUSY: &str = "too many requests wait here: try again later\n";
    let path = CString::new(request.uri().path()).unwrap_or_default();
    if shared.requests.lock().unwrap().is_none() {
        return (StatusCode::FORBIDDEN, "this page may only show the scene: it takes no commands\n").into_response();
    }
    let (waiting, answer) = {
        let mut all = shared.requests.lock().unwrap();
        let Some(requests) = all.as_mut().filter(|requests| requests.has_room(place.from())) else {
            return (StatusCode::SERVICE_UNAVAILABLE, BUSY).into_response();
        };
        requests.last += 1;
        let (ticket, (sender, answer)) = (requests.last, oneshot::channel());
        requests.answers.insert(ticket, (place.from(), sender));
        (Waiting { shared: shared.clone(), ticket }, answer)
    };
    let Ok(body) = timeout(ANSWERED, to_bytes(request.into_body(), MAX_REQUEST)).await else {
        return (StatusCode::REQUEST_TIMEOUT, "the request did not arrive in time\n").into_response();
    };
    let Ok(data) = body else {
        return (StatusCode::PAYLOAD_TOO_LARGE, "the request is longer than 1 MiB, the most that is allowed\n").into_response();
    };
    if let Some(requests) = shared.requests.lock().unwrap().as_mut() {
        requests.line.push_back(Asked { ticket: waiting.ticket, path, data });
    }
    let answered = timeout(ANSWERED, answer).await;
    drop(waiting);
    match answered {
        Ok(Ok(response)) => response,
        _ => (StatusCode::GATEWAY_TIMEOUT, "no answer came in time\n").into_response(),
    }
}

async fn upgrade(
    State(shared): State<Arc<Shared>>,
    Extension(place): Extension<Arc<Place>>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !shared.places.make_live(&place, MAX_BROWSERS) {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many browsers watch here\n").into_response();
    }
    let bounded = upgrade.read_buffer_size(MAX_ANSWER).max_frame_size(MAX_ANSWER).max_message_size(MAX_ANSWER);
    bounded.write_buffer_size(0).on_upgrade(|socket| async move {
        live(socket, &shared).await;
        drop(place);
    })
}

/// Runs until the browser disconnects or has answered nothing for too long. Its page reconnects by itself when it can.
async fn live(mut socket: WebSocket, shared: &Shared) {
    let mut changed = shared.changed.subscribe();
    changed.mark_changed(); // send the whole state at once
    let (mut round, mut sent) = (VecDeque::new(), 0);
    let (mut unanswered, mut heard) = (0, Instant::now());
    loop {
        tokio::select! {
            came = changed.changed(), if unanswered < WINDOW => {
                if came.is_err() {
                    return;
                }
                let goes_on = !round.is_empty();
                if !goes_on {
                    sleep(GATHER).await;
                    changed.mark_unchanged();
                    (round, sent) = shared.state.lock().unwrap().since(sent);
                }
                let batch = batch(&mut round);
                if goes_on || !round.is_empty() {
                    changed.mark_changed(); // for the rest, and for what was set meanwhile
                }
                if batch.is_empty() {
                    continue;
                }
                if !matches!(timeout(PATIENCE, socket.send(Message::Binary(batch.into()))).await, Ok(Ok(()))) {
                    return;
                }
                if unanswered == 0 {
                    heard = Instant::now();
                }
                unanswered += 1;
            }
            answer = socket.recv() => match answer {
                Some(Ok(Message::Binary(_))) => {
                    unanswered = unanswered.saturating_sub(1);
                    heard = Instant::now();
                }
                // Send its pong before another one is queued.
                Some(Ok(Message::Ping(_))) => if !matches!(timeout(PATIENCE, socket.flush()).await, Ok(Ok(()))) {
                    return;
                },
                Some(Ok(Message::Pong(_))) => {}
                _ => return,
            },
            _ = sleep_until(heard + PATIENCE), if unanswered > 0 => return,
        }
    }
}

/// Encodes the first of these slots; web.h describes the format.
fn batch(round: &mut VecDeque<Slot>) -> Vec<u8> {
    let mut bytes = Vec::new();
    while let Some(slot) = round.front().filter(|slot| bytes.is_empty() || bytes.len() + slot.data.len() <= MAX_BATCH) {
        bytes.extend_from_slice(&(slot.key.len() as u16).to_le_bytes());
        bytes.extend_from_slice(&(slot.data.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&(slot.since.elapsed().as_millis() as u32).to_le_bytes());
        bytes.extend_from_slice(slot.key.as_bytes());
        bytes.extend_from_slice(&slot.data);
        round.pop_front();
    }
    bytes
}
