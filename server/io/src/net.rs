//! A zenoh session without callbacks to the caller. Outgoing: threads make every zenoh call that could wait. One publishes, one
//! asks, one ends queries that get no answer, and up to eight answer, so that an asker that takes nothing delays neither the streams nor other askers. Incoming:
//! zenoh's callbacks only copy into the bounded inbox and wake the poller. Samples are sent with Drop: a frozen subscriber
//! loses samples, the others none.

use crate::bytes::Aligned;
use crate::config::{self, MAX_MESSAGE};
use crate::fail::{BAD_ARGUMENT, CLOSED, DROPPED, Fail, IO, said};
use crate::inbox::{Counts, Event, Inbox, IsNewer, Kind, REPLIES, SourceId};
use crate::queue::{Next, Queue, Refused};
use std::any::Any;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ffi::CString;
use std::ops::Bound;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Query, QueryTarget};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::{Session, Wait};
use zenoh_runtime::ZRuntime;

/// Samples that wait for the publishing thread. It lags only while zenoh waits for a slow link (1 ms per sample at most).
const PUT_BYTES: usize = 32 << 20;
const PUT_ITEMS: usize = 1 << 16;
/// Questions and declarations that wait for the asking thread, and answers that wait for the answering threads.
const ASK_BYTES: usize = 64 << 20;
const ASK_ITEMS: usize = 1 << 14;
/// Most answering threads; a new one starts when the others are busy. zenoh waits in them for a link that takes nothing, at
/// most 1 s. It does not say who asked, so an asker that leaves eight answers of more than a link holds untaken still delays
/// the others.
const MAX_ANSWERING: usize = 8;
/// Answers to our questions that were not polled yet.
const MAX_REPLIES: usize = 4096;
/// Most queries that were polled and not answered yet. Beyond it the oldest is given up, so that its asker gets the end.
const MAX_OPEN_QUERIES: usize = 4096;
/// Most bytes of a received key, and of a query's parameters: our longest keys have 83, and our queries have no parameters.
const MAX_KEY: usize = 256;
/// Most keys on which this session publishes: 1,000 cars have 4,000, hosts one each. Each takes 10 KB, zenoh's part included.
const MAX_KEYS: usize = 1 << 13;
/// The key of the query by which a closing session learns that everything it sent has arrived. Whoever may watch may query it,
/// and no scene's id contains this character.
const LAST_KEY: &str = "crumple/1/~/health";
const LAST_WAIT: Duration = Duration::from_secs(1);
/// Most preferred keys: two of each of 64 hosts, twice.
const MAX_PREFERRED: usize = 256;
/// Alive and gone reports that were not polled yet.
const MAX_REPORTS: usize = 1 << 16;
/// Queries have a priority that no sample has. zenoh keeps a queue per priority, and an answer inherits its query's, so a
/// blocked answer never delays a sample.
const ASK_PRIORITY: Priority = Priority::DataHigh;

#[derive(Default)]
pub struct Sent {
    pub put: AtomicU64,
    pub put_bytes: AtomicU64,
    pub put_dropped: AtomicU64,
}

/// A key on which this session publishes.
struct Key {
    name: KeyExpr<'static>,
    index: u64,
    matching: AtomicBool,
}

enum Put {
    Declare(Arc<Key>),
    Sample(Arc<Key>, Priority, Vec<u8>),
    Withdraw(Arc<Key>),
}

enum Ask {
    Subscribe(KeyExpr<'static>, SourceId),
    Unsubscribe(KeyExpr<'static>),
    Queryable(KeyExpr<'static>, SourceId),
    Announce(KeyExpr<'static>),
    Retract(KeyExpr<'static>),
    Watch(KeyExpr<'static>, SourceId),
    Get { key: KeyExpr<'static>, data: Vec<u8>, timeout: Duration, ticket: u64 },
}

struct Answer {
    query: Box<Waiting>,
    data: Vec<u8>,
    failed: bool,
}

/// A query, and the key for its answer.
struct Waiting {
    query: Query,
    key: KeyExpr<'static>,
}

/// The data that the callbacks need.
struct Shared {
    inbox: Inbox,
    open_queries: Mutex<BTreeMap<u64, Box<Waiting>>>,
    tickets: AtomicU64,
    answers: Queue<Answer>,
    ends: Queue<Box<Waiting>>, // queries that get no answer
    answering: Mutex<Vec<JoinHandle<()>>>,
}

pub struct Net {
    session: Session,
    endpoint: CString,
    shared: Arc<Shared>,
    sent: Sent,
    puts: Arc<Queue<Put>>,
    asks: Arc<Queue<Ask>>,
    keys: Mutex<BTreeMap<String, Arc<Key>>>,
    keys_so_far: AtomicU64,
    threads: Vec<JoinHandle<()>>,
    pub polled: Mutex<Vec<Event>>,
}

impl Net {
    pub fn open(mode: &str, listen: &[&str], connect: &[&str], overlay: Option<&str>, timeout_ms: u32) -> Result<Net, Fail> {
        let config = config::build(mode, listen, connect, overlay, timeout_ms)?;
        begin_threads();
        let session = zenoh::open(config).wait().map_err(|e| {
            let (verb, ends, remedy) = match mode {
                "client" => ("connect to", connect, "is a server running there?"),
                _ => ("listen on", listen, "is the port free and the address this machine's?"),
            };
            Fail::new(IO, format!("cannot {verb} {}: {remedy} ({})", ends.join(", "), said(&e)))
        })?;
        let mut endpoints: Vec<String> = session.info().locators().wait().iter().map(|locator| locator.to_string()).collect();
        endpoints.sort();
        let shared = Arc::new(Shared {
            inbox: Inbox::new(MAX_REPLIES),
            open_queries: Mutex::default(),
            tickets: AtomicU64::new(1),
            answers: Queue::new(ASK_BYTES, ASK_ITEMS),
            ends: Queue::new(1, ASK_ITEMS),
            answering: Mutex::default(),
        });
        let puts = Arc::new(Queue::new(PUT_BYTES, PUT_ITEMS));
        let asks = Arc::new(Queue::new(ASK_BYTES, ASK_ITEMS));
        let publishing = {
            let (session, puts) = (session.clone(), puts.clone());
            thread("net publish", move || publish(&session, &puts))?
        };
        let asking = {
            let (session, shared, asks) = (session.clone(), shared.clone(), asks.clone());
            thread("net ask", move || ask(&session, &shared, &asks))?
        };
        let ending = {
            let shared = shared.clone();
            thread("net end", move || {
                while let Next::Item(query) = shared.ends.pop(None) {
                    drop(query)
                }
            })?
        };
        Ok(Net {
            session,
            endpoint: CString::new(endpoints.join(",")).unwrap_or_default(),
            shared,
            sent: Sent::default(),
            puts,
            asks,
            keys: Mutex::default(),
            keys_so_far: AtomicU64::new(0),
            threads: vec![publishing, asking, ending],
            polled: Mutex::default(),
        })
    }

    /// Publishes and answers what is queued, undeclares everything, and closes the session.
    pub fn close(mut self) {
        self.puts.close();
        self.asks.close();
        self.shared.answers.close();
        self.shared.ends.close();
        let answering = std::mem::take(&mut *self.shared.answering.lock().unwrap());
        for thread in self.threads.drain(..).chain(answering) {
            _ = thread.join();
        }
        reach_the_other_end(&self.session);
        let unanswered = std::mem::take(&mut *self.shared.open_queries.lock().unwrap());
        drop(unanswered);
        _ = self.session.close().wait();
    }

    /// Whether some other session is linked to this one now.
    pub fn connected(&self) -> bool {
        let info = self.session.info();
        info.routers_zid().wait().next().is_some() || info.peers_zid().wait().next().is_some()
    }

    pub fn endpoint(&self) -> &CString {
        &self.endpoint
    }

    pub fn counts(&self) -> (&Sent, &Counts) {
        (&self.sent, &self.shared.inbox.counts)
    }

    /// Number of keys on which this session publishes.
    pub fn key_count(&self) -> usize {
        self.keys.lock().unwrap().len()
    }

    pub fn put(&self, key: &str, data: &[u8], priority: i32) -> Result<(), Fail> {
        let priority = match priority {
            1 => Priority::RealTime,
            2 => Priority::InteractiveHigh,
            5 => Priority::Data,
            6 => Priority::DataLow,
            other => {
                return Err(Fail::new(BAD_ARGUMENT, format!("{key}: {other} is not one of the priorities of NetPriority")));
            }
        };
        check_size(key, data)?;
        let key = self.key(key)?;
        self.puts.push(Put::Sample(key, priority, data.to_vec()), data.len()).map_err(|(refused, _)| {
            self.sent.put_dropped.fetch_add(1, Relaxed);
            refusal(refused)
        })?;
        self.sent.put.fetch_add(1, Relaxed);
        self.sent.put_bytes.fetch_add(data.len() as u64, Relaxed);
        Ok(())
    }

    /// False until the publishing thread has declared the key, at the first call or put.
    pub fn matching(&self, key: &str) -> Result<bool, Fail> {
        Ok(self.key(key)?.matching.load(Relaxed))
    }

    /// Undeclares the keys with this prefix, until the next put on them.
    pub fn withdraw(&self, prefix: &str) {
        let mut keys = self.keys.lock().unwrap();
        let from = (Bound::Included(prefix), Bound::Unbounded);
        let names = keys.range::<str, _>(from).map(|(name, _)| name).take_while(|name| name.starts_with(prefix));
        for name in names.cloned().collect::<Vec<_>>() {
            // if the queue is full, this one stays declared
            if self.puts.push(Put::Withdraw(keys[&name].clone()), 0).is_ok() {
                keys.remove(&name);
            }
        }
    }

    /// is_newer: for depth 0.
    pub fn subscribe(&self, key: &str, depth: u32, longest: usize, is_newer: Option<IsNewer>) -> Result<(), Fail> {
        let key = key_expression(key)?;
        let source = self.shared.inbox.add_source(depth as usize, longest, is_newer);
        self.ask(Ask::Subscribe(key, source), 0)
    }

    pub fn prefer(&self, keys: &str) -> Result<(), Fail> {
        let keys: HashSet<_> = keys.split(',').filter_map(|key| CString::new(key).ok()).collect();
        if keys.len() > MAX_PREFERRED {
            let sentence = format!("{} keys are too many to prefer: at most {MAX_PREFERRED} are allowed", keys.len());
            return Err(Fail::new(BAD_ARGUMENT, sentence));
        }
        self.shared.inbox.prefer(keys);
        Ok(())
    }

    pub fn unsubscribe(&self, key: &str) -> Result<(), Fail> {
        self.ask(Ask::Unsubscribe(key_expression(key)?), 0)
    }

    pub fn queryable(&self, key: &str, depth: u32, longest: usize) -> Result<(), Fail> {
        let key = key_expression(key)?;
        let source = self.shared.inbox.add_source(depth.max(1) as usize, longest, None);
        self.ask(Ask::Queryable(key, source), 0)
    }

    pub fn announce(&self, key: &str) -> Result<(), Fail> {
        self.ask(Ask::Announce(one_key(key)?), 0)
    }

    pub fn retract(&self, key: &str) -> Result<(), Fail> {
        self.ask(Ask::Retract(one_key(key)?), 0)
    }

    pub fn watch(&self, key: &str) -> Result<(), Fail> {
        let key = key_expression(key)?;
        let source = self.shared.inbox.add_source(MAX_REPORTS, 0, None);
        self.ask(Ask::Watch(key, source), 0)
    }

    pub fn get(&self, key: &str, data: &[u8], timeout_ms: u32) -> Result<u64, Fail> {
        check_size(key, data)?;
        let ticket = self.shared.tickets.fetch_add(1, Relaxed);
        let timeout = Duration::from_millis(timeout_ms.max(1).into());
        self.ask(Ask::Get { key: key_expression(key)?, data: data.to_vec(), timeout, ticket }, data.len())?;
        Ok(ticket)
    }

    pub fn reply(&self, ticket: u64, data: &[u8], failed: bool) -> Result<(), Fail> {
        check_size("a reply", data)?;
        let Some(query) = self.shared.open_queries.lock().unwrap().remove(&ticket) else {
            return Err(Fail::new(BAD_ARGUMENT, format!("no query waits under ticket {ticket}: it was answered or given up")));
        };
        self.shared.answer(Answer { query, data: data.to_vec(), failed }, data.len()).map_err(refusal)
    }

    /// Frees the events of the last poll, then puts up to `most` new ones into `polled`.
    pub fn poll(&self, polled: &mut Vec<Event>, most: usize, timeout_us: u64) {
        polled.clear();
        self.shared.inbox.take(most, Duration::from_micros(timeout_us), polled);
    }

    fn key(&self, name: &str) -> Result<Arc<Key>, Fail> {
        let mut keys = self.keys.lock().unwrap();
        if let Some(key) = keys.get(name) {
            return Ok(key.clone());
        }
        if keys.len() >= MAX_KEYS {
            let sentence = format!("{name}: this session publishes on {MAX_KEYS} keys already: withdraw some");
            return Err(Fail::new(DROPPED, sentence));
        }
        let index = self.keys_so_far.fetch_add(1, Relaxed);
        let key = Arc::new(Key { name: one_key(name)?, index, matching: AtomicBool::new(false) });
        self.puts.push(Put::Declare(key.clone()), 0).map_err(|(refused, _)| refusal(refused))?;
        keys.insert(name.to_string(), key.clone());
        Ok(key)
    }

    fn ask(&self, ask: Ask, bytes: usize) -> Result<(), Fail> {
        self.asks.push(ask, bytes).map_err(|(refused, _)| refusal(refused))
    }
}

/// zenoh begins its threads when it first needs them. If no descriptors are left then, as when strangers hold them all, it panics.
fn begin_threads() {
    for runtime in [ZRuntime::Application, ZRuntime::Acceptor, ZRuntime::TX, ZRuntime::RX, ZRuntime::Net] {
        let _: &tokio::runtime::Handle = &runtime;
    }
}

/// A socket does not linger at its end (.cargo/config.toml). So this sends a query of the lowest priority that nobody answers:
/// its end comes back from the other end of a link after everything that was sent before it.
fn reach_the_other_end(session: &Session) {
    let (ended, end) = std::sync::mpsc::channel::<()>();
    let asked = session
        .get(LAST_KEY)
        .timeout(LAST_WAIT)
        .target(QueryTarget::All)
        .congestion_control(CongestionControl::Block)
        .priority(Priority::Background)
        .allowed_destination(Locality::Remote)
        .callback(move |_| _ = &ended) // dropped when the query ends
        .wait();
    if asked.is_ok() {
        _ = end.recv_timeout(LAST_WAIT);
    }
}

fn thread(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, Fail> {
    let spawned = std::thread::Builder::new().name(name.into()).spawn(work);
    spawned.map_err(|e| Fail::new(IO, format!("no thread for the network session ({e}); raise the limit of threads")))
}

fn refusal(refused: Refused) -> Fail {
    match refused {
        Refused::Full => Fail::new(DROPPED, "the session's queue is full: more is sent than the network takes"),
        Refused::Closed => Fail::new(CLOSED, "the session is closed"),
    }
}

fn check_size(key: &str, data: &[u8]) -> Result<(), Fail> {
    if data.len() > MAX_MESSAGE {
        let size = data.len();
        return Err(Fail::new(
            BAD_ARGUMENT,
            format!("{key}: {size} bytes are over the limit of {MAX_MESSAGE} for one message"),
        ));
    }
    Ok(())
}

fn key_expression(text: &str) -> Result<KeyExpr<'static>, Fail> {
    KeyExpr::try_from(text.to_string())
        .map_err(|e| Fail::new(BAD_ARGUMENT, format!("\"{text}\" is not a key expression: {}", said(&e))))
}

fn one_key(text: &str) -> Result<KeyExpr<'static>, Fail> {
    let key = key_expression(text)?;
    if key.is_wild() {
        return Err(Fail::new(BAD_ARGUMENT, format!("\"{text}\" names many keys; this needs one, without *")));
    }
    Ok(key)
}

// ---- the publishing thread ----

fn publish(session: &Session, puts: &Queue<Put>) {
    let mut publishers: HashMap<u64, HashMap<u8, Publisher<'static>>> = HashMap::new();
    loop {
        match puts.pop(None) {
            Next::Item(Put::Declare(key)) => {
                watch_matching(session, &key, publishers.entry(key.index).or_default());
            }
            Next::Item(Put::Sample(key, priority, data)) => {
                // a key that was withdrawn meanwhile has no publishers
                let declared = publishers.get_mut(&key.index);
                if let Some(publisher) = declared.and_then(|declared| publisher(session, &key, priority, declared)) {
                    _ = publisher.put(data).wait(); // fails only if the session is closed
                }
            }
            Next::Item(Put::Withdraw(key)) => _ = publishers.remove(&key.index), // dropping them undeclares them
            Next::TimedOut => {}
            Next::Closed => return,
        }
    }
}

/// One publisher per key and priority (nearly always one per key), declared at first use and kept until the key is withdrawn.
fn publisher<'a>(
    session: &Session,
    key: &Key,
    priority: Priority,
    declared: &'a mut HashMap<u8, Publisher<'static>>,
) -> Option<&'a Publisher<'static>> {
    if !declared.contains_key(&(priority as u8)) {
        let publisher = session
            .declare_publisher(key.name.clone())
            .congestion_control(CongestionControl::Drop)
            .priority(priority)
            .express(priority == Priority::RealTime) // not batched with later samples
            .allowed_destination(Locality::Remote)
            .wait();
        declared.insert(priority as u8, publisher.ok()?);
    }
    declared.get(&(priority as u8))
}

fn watch_matching(session: &Session, key: &Arc<Key>, declared: &mut HashMap<u8, Publisher<'static>>) {
    if let Some(publisher) = publisher(session, key, Priority::Data, declared) {
        let key = key.clone();
        let set = move |status: zenoh::matching::MatchingStatus| key.matching.store(status.matching(), Relaxed);
        _ = publisher.matching_listener().callback(set).background().wait();
    }
}

// ---- the asking thread ----

fn ask(session: &Session, shared: &Arc<Shared>, asks: &Queue<Ask>) {
    let mut declared: Vec<Box<dyn Any>> = Vec::new(); // dropped at the end, which undeclares them
    let mut tokens = HashMap::new();
    let mut subscribers = HashMap::new();
    loop {
        let done = match asks.pop(None) {
            Next::Item(Ask::Subscribe(key, source)) => {
                let shared = shared.clone();
                let take = move |sample: Sample| shared.sample(source, &sample);
                let subscriber = session.declare_subscriber(key.clone()).callback(take).wait();
                subscriber.map(|it| subscribers.entry(key).or_insert_with(Vec::new).push((it, source)))
            }
            Next::Item(Ask::Unsubscribe(key)) => {
                subscribers.remove(&key).into_iter().flatten().try_for_each(|(subscriber, source)| {
                    let done = subscriber.undeclare().wait();
                    shared.inbox.free_source(source);
                    done
                })
            }
            Next::Item(Ask::Queryable(key, source)) => {
                let (shared, own) = (shared.clone(), key.clone());
                let take = move |query: Query| shared.query(source, &own, query);
                session.declare_queryable(key).callback(take).wait().map(|it| declared.push(Box::new(it)))
            }
            Next::Item(Ask::Announce(key)) => {
                session.liveliness().declare_token(key.clone()).wait().map(|it| _ = tokens.insert(key, it))
            }
            Next::Item(Ask::Retract(key)) => tokens.remove(&key).map_or(Ok(()), |token| token.undeclare().wait()),
            Next::Item(Ask::Watch(key, source)) => {
                let shared = shared.clone();
                let take = move |sample: Sample| shared.report(source, &sample);
                let liveliness = session.liveliness();
                liveliness.declare_subscriber(key).history(true).callback(take).wait().map(|it| declared.push(Box::new(it)))
            }
            Next::Item(Ask::Get { key, data, timeout, ticket }) => get(session, shared, key, data, timeout, ticket),
            Next::TimedOut => Ok(()),
            Next::Closed => return,
        };
        _ = done; // the caller has checked the keys, so zenoh refuses only on a closed session
    }
}

// ---- the answering threads ----

impl Shared {
    fn answer(self: &Arc<Self>, answer: Answer, bytes: usize) -> Result<(), Refused> {
        if let Err((refused, answer)) = self.answers.push(answer, bytes) {
            self.end(answer.query);
            return Err(refused);
        }
        let mut answering = self.answering.lock().unwrap();
        if self.answers.is_behind() && answering.len() < MAX_ANSWERING {
            let shared = self.clone();
            // if no thread can be had, answers only wait longer
            answering.extend(thread("net answer", move || shared.work()));
        }
        Ok(())
    }

    /// Ends a query without an answer. zenoh sends the end in the thread that drops the query, and waits there for a link that takes
    /// nothing. If even this queue is full, the query stays open until it is given up.
    fn end(&self, query: Box<Waiting>) {
        if let Err((_, query)) = self.ends.push(query, 0) {
            let ticket = self.tickets.fetch_add(1, Relaxed);
            self.open_queries.lock().unwrap().insert(ticket, query);
        }
    }

    /// Ignores failures: an asker that is gone needs no answer.
    fn work(&self) {
        while let Next::Item(Answer { query, data, failed }) = self.answers.pop(None) {
            _ = if failed { query.query.reply_err(data).wait() } else { query.query.reply(&query.key, data).wait() };
        }
    }
}

fn get(
    session: &Session,
    shared: &Arc<Shared>,
    key: KeyExpr<'static>,
    data: Vec<u8>,
    timeout: Duration,
    ticket: u64,
) -> Result<(), zenoh::Error> {
    let asked = Asked { shared: shared.clone(), key: c_key(&key), ticket };
    let take = move |reply: zenoh::query::Reply| asked.reply(&reply);
    session
        .get(key)
        .payload(data)
        .timeout(timeout)
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None) // answers arrive as they come, not at the end
        .congestion_control(CongestionControl::Block)
        .priority(ASK_PRIORITY)
        .allowed_destination(Locality::Remote)
        .callback(take)
        .wait()
}

/// A question under way. zenoh drops it after the last answer or the timeout; the drop reports the end to the asker.
struct Asked {
    shared: Arc<Shared>,
    key: CString,
    ticket: u64,
}

impl Asked {
    fn reply(&self, reply: &zenoh::query::Reply) {
        let (failed, key, payload) = match reply.result() {
            Ok(sample) => (false, c_key(sample.key_expr()), sample.payload()),
            Err(error) => (true, self.key.clone(), error.payload()),
        };
        if self.shared.inbox.refuses(REPLIES, Kind::Reply, &key, payload.len()) {
            return;
        }
        let event = Event { kind: Kind::Reply, failed, key, data: aligned(payload), ticket: self.ticket };
        self.shared.inbox.push(REPLIES, event);
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        let key = std::mem::take(&mut self.key);
        let end = Event { kind: Kind::ReplyEnd, failed: false, key, data: Aligned::default(), ticket: self.ticket };
        self.shared.inbox.push(REPLIES, end);
    }
}

// ---- zenoh's threads ----

impl Shared {
    fn sample(&self, source: SourceId, sample: &Sample) {
        // Nothing in our protocol deletes keys, and a delete has no payload to deliver.
        let bad = sample.kind() == SampleKind::Delete || !is_plain(sample.key_expr());
        let key = c_key(sample.key_expr());
        if bad {
            self.inbox.counts.refused(Kind::Sample);
        } else if !self.inbox.is_oversized(source, sample.payload().len())
            && !self.inbox.refuses(source, Kind::Sample, &key, sample.payload().len())
        {
            let data = aligned(sample.payload());
            self.inbox.push(source, Event { kind: Kind::Sample, failed: false, key, data, ticket: 0 });
        }
    }

    fn report(&self, source: SourceId, sample: &Sample) {
        let kind = if sample.kind() == SampleKind::Put { Kind::Alive } else { Kind::Gone };
        if !is_plain(sample.key_expr()) {
            return self.inbox.counts.refused(kind);
        }
        let key = c_key(sample.key_expr());
        self.inbox.push(source, Event { kind, failed: false, key, data: Aligned::default(), ticket: 0 });
    }

    /// A query is answered under the queryable's own key or, if that names many, under the query's key. Its payload is not kept
    /// until it is answered.
    fn query(self: &Arc<Self>, source: SourceId, own: &KeyExpr<'static>, mut query: Query) {
        let ticket = self.tickets.fetch_add(1, Relaxed);
        let payload = query.payload_mut().map(std::mem::take).unwrap_or_default();
        _ = query.attachment_mut().map(std::mem::take);
        let too_long = |what: &str| format!("{what} is longer than the server accepts").into_bytes();
        let key = c_key(query.key_expr());
        let refused = if !is_plain(query.key_expr()) || query.parameters().as_str().len() > MAX_KEY {
            self.inbox.counts.refused(Kind::Query);
            Some(too_long("the key of a query, or its list of parameters,"))
        } else if self.inbox.is_oversized(source, payload.len()) {
            Some(too_long(&format!("a question of {} bytes", payload.len())))
        } else if self.inbox.refuses(source, Kind::Query, &key, payload.len()) {
            Some(b"too many questions wait here: ask again later".to_vec())
        } else {
            None
        };
        if let Some(data) = refused {
            let query = Box::new(Waiting { query, key: own.clone() });
            _ = self.answer(Answer { query, data, failed: true }, 64); // if full: the end without an answer
            return;
        }
        let data = aligned(&payload);
        drop(payload);
        let answer_key = if own.is_wild() { query.key_expr().clone() } else { own.clone() };
        let waiting = Box::new(Waiting { query, key: answer_key });
        // must happen before the poller can see the ticket
        let given_up = {
            let mut open = self.open_queries.lock().unwrap();
            open.insert(ticket, waiting);
            if open.len() > MAX_OPEN_QUERIES { open.pop_first() } else { None }
        };
        drop(given_up);
        let event = Event { kind: Kind::Query, failed: false, key, data, ticket };
        if self.inbox.push(source, event) {
            return;
        }
        let refused = self.open_queries.lock().unwrap().remove(&ticket);
        if let Some(query) = refused {
            let sentence = b"too many questions wait here: ask again later".to_vec();
            _ = self.answer(Answer { query, data: sentence, failed: true }, 64); // if full: the end without an answer
        }
    }
}

fn aligned(payload: &ZBytes) -> Aligned {
    Aligned::gather(payload.len(), payload.slices())
}

/// A key expression may contain a zero byte, at which it would end as a C string and become another key; and it may have 64 KB.
fn is_plain(key: &KeyExpr<'_>) -> bool {
    key.as_str().len() <= MAX_KEY && !key.as_str().contains('\0')
}

/// Empty if it is not plain.
fn c_key(key: &KeyExpr<'_>) -> CString {
    CString::new(key.as_str()).unwrap_or_default()
}
