//! The HTTP server of metrics and of pages: accepts connections and bounds their number, time and memory, whatever the other
//! end does. Its user supplies a router, which makes the answers. One address gets at most half of the places. When a newcomer
//! finds no place, the connection that was idle for longest is closed, except those that wait for an answer or are WebSockets.

use crate::fail::{BAD_ARGUMENT, Fail, IO};
use axum::extract::{Extension, Request};
use axum::http::{HeaderName, HeaderValue, header};
use axum::middleware::{self, Next};
use axum::response::Response;
use axum::{Router, body::Body};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use socket2::SockRef;
use std::ffi::CString;
use std::io;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, Weak};
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::Runtime;
use tokio::sync::Notify;
use tokio::time::{Instant, Sleep, sleep};

/// Time for the head of a request, and between two requests of a connection.
const HEAD_TIME: Duration = Duration::from_secs(10);
/// Most bytes of a head, and of a body that are read ahead: browsers send the cookies of every port of a machine.
const MAX_HEAD: usize = 16 << 10;
/// A reader that takes nothing, or a browser that answers nothing, for this long is disconnected.
pub const PATIENCE: Duration = Duration::from_secs(30);
/// Connections that wait to be accepted. More than ever come at once, because the kernel makes those without room retry after 1
/// s.
const MAX_COMING: i32 = 1024;
/// Pause before the next attempt to accept when there was no descriptor left.
const TRY_AGAIN: Duration = Duration::from_millis(100);
/// Time for tasks to end when the server closes.
const CLOSING: Duration = Duration::from_secs(1);

/// A page is one file with its scripts and style, some of them WebAssembly (the hash of a surface). It may talk only to this
/// server, and to files that the user opens in it (data: and blob:), and no page may show it in a frame.
const MAY: &str = "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; \
                   img-src 'self' data: blob:; connect-src 'self' data: blob:; object-src 'none'; base-uri 'none'; \
                   form-action 'self'; frame-ancestors 'none'";
const DRESS: [(HeaderName, &str); 4] = [
    (header::CONTENT_SECURITY_POLICY, MAY),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
];

pub struct Door {
    pub places: Arc<Places>,
    pub local: SocketAddr,
    address: CString,
    runtime: Option<Runtime>,
    listener: Option<TcpListener>,
}

impl Door {
    /// Listens at "HOST:PORT" with this many places; `what` names the server in sentences.
    pub fn open(what: &str, address: &str, places: usize) -> Result<Door, Fail> {
        if !address.contains(':') {
            return Err(Fail::new(BAD_ARGUMENT, format!("{what} at {address}: give HOST:PORT, such as 127.0.0.1:8080")));
        }
        let cannot = |e: io::Error| {
            Fail::new(IO, format!("cannot show {what} at {address}: is the port free and the address this machine's? ({e})"))
        };
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).thread_name("http").enable_all().build();
        let runtime = runtime.map_err(cannot)?;
        let listener = runtime.block_on(TcpListener::bind(address)).map_err(cannot)?;
        SockRef::from(&listener).listen(MAX_COMING).map_err(cannot)?;
        let local = listener.local_addr().map_err(cannot)?;
        Ok(Door {
            places: Arc::new(Places { most: places, taken: Mutex::default(), refused: AtomicU64::new(0) }),
            local,
            address: CString::new(local.to_string()).unwrap_or_default(),
            runtime: Some(runtime),
            listener: Some(listener),
        })
    }

    /// Starts answering with the router. Its handlers find their Arc<Place> as an Extension.
    pub fn serve(&mut self, router: Router) {
        if let (Some(runtime), Some(listener)) = (&self.runtime, self.listener.take()) {
            runtime.spawn(accept(listener, router.layer(middleware::from_fn(answer)), self.places.clone()));
        }
    }

    pub fn address(&self) -> &CString {
        &self.address
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(CLOSING);
        }
    }
}

async fn accept(listener: TcpListener, router: Router, places: Arc<Places>) {
    let mut server = http1::Builder::new();
    server.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME).max_buf_size(MAX_HEAD);
    loop {
        let Ok((stream, from)) = listener.accept().await else {
            sleep(TRY_AGAIN).await;
            continue;
        };
        let Some(place) = places.take(from.ip()) else { continue };
        _ = stream.set_nodelay(true); // because a head and its body are written separately
        let router = router.clone().layer(Extension(place.clone()));
        let line = TokioIo::new(Line { stream, place: place.clone(), stuck: None });
        let connection = server.serve_connection(line, TowerToHyperService::new(router)).with_upgrades();
        tokio::spawn(async move {
            tokio::select! {
                _ = connection => {}
                () = place.left.notified() => {}
            }
        });
    }
}

async fn answer(Extension(place): Extension<Arc<Place>>, request: Request, next: Next) -> Response {
    place.set(Use::Answering);
    let mut response: Response<Body> = next.run(request).await;
    if place.is(Use::Answering) {
        place.set(Use::Reading);
    }
    for (name, value) in DRESS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

#[derive(Clone, Copy, PartialEq)]
enum Use {
    Reading, // reading a request, or sent its answer
    Answering,
    Live, // a WebSocket
    Left,
}

/// One connection's place, as long as somebody holds it.
pub struct Place {
    from: IpAddr,
    state: Mutex<(Use, Instant)>, // with the time of its last progress
    left: Notify,
}

impl Place {
    /// The address, or the network that counts as one address.
    pub fn from(&self) -> IpAddr {
        self.from
    }

    fn set(&self, to: Use) {
        *self.state.lock().unwrap() = (to, Instant::now());
    }

    fn is(&self, what: Use) -> bool {
        self.state.lock().unwrap().0 == what
    }

    fn moved(&self) {
        self.state.lock().unwrap().1 = Instant::now();
    }
}

pub struct Places {
    most: usize,
    taken: Mutex<Vec<Weak<Place>>>,
    refused: AtomicU64,
}

impl Places {
    /// Connections that were closed or refused because all places, or all places of an address, were taken.
    pub fn refused(&self) -> u64 {
        self.refused.load(Relaxed)
    }

    fn take(&self, from: IpAddr) -> Option<Arc<Place>> {
        let from = household(from);
        let mut taken = self.taken.lock().unwrap();
        taken.retain(|place| place.strong_count() > 0);
        let all: Vec<_> = taken.iter().filter_map(Weak::upgrade).filter(|place| !place.is(Use::Left)).collect();
        let crowded = all.iter().filter(|place| place.from == from).count() >= self.most / 2;
        if crowded || all.len() >= self.most {
            self.refused.fetch_add(1, Relaxed);
            let idle = all.iter().filter(|place| place.is(Use::Reading) && (!crowded || place.from == from));
            let oldest = idle.min_by_key(|place| place.state.lock().unwrap().1)?;
            oldest.set(Use::Left);
            oldest.left.notify_one();
        }
        let place = Arc::new(Place { from, state: Mutex::new((Use::Reading, Instant::now())), left: Notify::new() });
        taken.push(Arc::downgrade(&place));
        Some(place)
    }

    /// Makes the connection a WebSocket if there are fewer than `most`, and fewer than half of them from its address.
    pub fn make_live(&self, place: &Place, most: usize) -> bool {
        let taken = self.taken.lock().unwrap();
        let live: Vec<_> = taken.iter().filter_map(Weak::upgrade).filter(|other| other.is(Use::Live)).collect();
        let fits = live.len() < most && live.iter().filter(|other| other.from == place.from).count() < most / 2;
        if fits {
            place.set(Use::Live);
        } else {
            self.refused.fetch_add(1, Relaxed);
        }
        fits
    }
}

/// Whoever has one IPv6 address has all 2^64 of its network, so they count as one.
fn household(from: IpAddr) -> IpAddr {
    match from.to_canonical() {
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() & !u128::from(u64::MAX)).into(),
        address => address,
    }
}

/// The stream to a reader. The reader must keep taking data, or it is disconnected.
struct Line {
    stream: TcpStream,
    place: Arc<Place>,
    stuck: Option<Pin<Box<Sleep>>>, // runs while the reader takes nothing
}

impl Line {
    fn wrote(&mut self, context: &mut Context<'_>, size: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        if size.is_ready() {
            self.stuck = None;
            self.place.moved();
            return size;
        }
        ready!(self.stuck.get_or_insert_with(|| Box::pin(sleep(PATIENCE))).as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

/// Discards data that the reader did not take; the kernel would keep it for minutes.
impl Drop for Line {
    fn drop(&mut self) {
        if self.stuck.is_some() || self.place.is(Use::Left) {
            _ = self.stream.set_zero_linger();
        }
    }
}

impl AsyncRead for Line {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, into)
    }
}

impl AsyncWrite for Line {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let size = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.wrote(context, size)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let first = slices.iter().find(|slice| !slice.is_empty()).map_or(&[][..], |slice| slice);
        self.poll_write(context, first)
    }

    // True, so that hyper keeps its data in pieces instead of copying it into one. But poll_write_vectored must not call
    // writev: that raises SIGPIPE if the reader is gone, while send, which poll_write uses, does not.
    fn is_write_vectored(&self) -> bool {
        true
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
