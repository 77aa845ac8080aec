//! Writes an MCAP file on its own thread. Schemas, channels, messages, attachments and metadata are copied into a bounded
//! queue. The file has only whole records (chunks are built in memory, nothing is patched later). It is flushed and synced
//! often enough that kill -9 loses no more than the last second. Messages that could not be written are counted, never hidden.

use crate::fail::{BAD_ARGUMENT, CLOSED, DROPPED, Fail, IO, causes};
use crate::queue::{Next, Queue, Refused};
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Attachment, Compression, McapError, McapResult, WriteOptions, Writer};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ffi::CString;
use std::fs::File;
use std::io::{BufWriter, ErrorKind, Write};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const QUEUE_BYTES: usize = 64 << 20;
const QUEUE_ITEMS: usize = 1 << 20;
/// size before compression; a reader holds one chunk at a time
const CHUNK_BYTES: u64 = 256 << 10;
/// The promise is one second; a tenth of it is left for the disk.
const SYNC_PERIOD: Duration = Duration::from_millis(900);
/// Least pause between two syncs, so that a disk that takes longer than a second gets whole chunks.
const SYNC_PAUSE: Duration = Duration::from_millis(100);
/// Memory of the index until the file is closed, in bytes, rounded up from measurements: per channel, per byte of its topic
/// (here and at the caller), per chunk, and per channel that has a message in a chunk.
const INDEX_OF_CHANNEL: u64 = 448;
const INDEX_OF_TOPIC: u64 = 2;
const INDEX_OF_CHUNK: u64 = 256;
const INDEX_OF_CHANNEL_IN_CHUNK: u64 = 30;
/// Head of a message in a chunk: opcode, length, channel, sequence, two times.
const MESSAGE_HEAD: u64 = 31;
/// MCAP numbers schemas and channels in 16 bits, from 1.
const MAX_IDS: usize = 65_535;

pub enum Item {
    Schema { name: String, bfbs: Vec<u8> },
    Channel { topic: String, schema: usize },
    Message { channel: usize, header: MessageHeader, data: Vec<u8> },
    Attachment { name: String, media_type: String, data: Vec<u8> },
    Metadata { name: String, pairs: BTreeMap<String, String> },
}

#[derive(Default)]
struct Shared {
    lost: AtomicU64,
    index: AtomicU64, // bytes
    trouble: OnceLock<(i32, CString)>,
}

pub struct Recorder {
    queue: Arc<Queue<Item>>,
    shared: Arc<Shared>,
    ids: Mutex<(usize, usize)>, // schemas, channels given out
    thread: JoinHandle<()>,
}

impl Recorder {
    pub fn open(path: &str, profile: &str, library: &str) -> Result<Recorder, Fail> {
        let cannot =
            |why: String| Fail::new(IO, format!("{path}: cannot record there: {why}; name a file in a writable folder"));
        let file = File::create(path).map_err(|e| cannot(e.to_string()))?;
        let sync = file.try_clone().map_err(|e| cannot(e.to_string()))?;
        // LZ4, not zstd: poses and deltas are small and partly compressed already, and the tick needs the processor more.
        let writer = WriteOptions::new()
            .profile(profile)
            .library(library)
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            .create(NoSeek::new(BufWriter::new(file)))
            .map_err(|e| cannot(causes(&e)))?;
        let queue = Arc::new(Queue::new(QUEUE_BYTES, QUEUE_ITEMS));
        let shared = Arc::new(Shared::default());
        let scribe = Scribe {
            path: path.to_string(),
            writer: Some(writer),
            sync,
            shared: shared.clone(),
            schemas: Vec::new(),
            channels: Vec::new(),
            chunk: Chunk { number: 1, bytes: 0 },
            unsynced: 0,
            sync_at: Instant::now(), // at once, for the header
        };
        let items = queue.clone();
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || scribe.run(&items))
            .map_err(|e| cannot(format!("no thread for it ({e})")))?;
        Ok(Recorder { queue, shared, ids: Mutex::new((0, 0)), thread })
    }

    /// Ids count from 0 in the order of the calls, which must also be their order in the queue; so both happen under the lock.
    pub fn schema(&self, name: String, bfbs: Vec<u8>) -> Result<usize, Fail> {
        let mut ids = self.ids.lock().unwrap();
        if ids.0 >= MAX_IDS {
            return Err(bad(format!("schema {name}: a recording holds at most {MAX_IDS} schemas")));
        }
        let bytes = bfbs.len();
        self.push(Item::Schema { name, bfbs }, bytes)?;
        ids.0 += 1;
        Ok(ids.0 - 1)
    }

    pub fn channel(&self, topic: String, schema: usize) -> Result<usize, Fail> {
        let mut ids = self.ids.lock().unwrap();
        if schema >= ids.0 {
            let given = ids.0;
            return Err(bad(format!("channel {topic}: schema {schema} is not one of the {given} that recorder_schema gave")));
        }
        if ids.1 >= MAX_IDS {
            return Err(bad(format!("channel {topic}: a recording holds at most {MAX_IDS} channels")));
        }
        let bytes = topic.len();
        self.push(Item::Channel { topic, schema }, bytes)?;
        ids.1 += 1;
        Ok(ids.1 - 1)
    }

    pub fn write(&self, channel: usize, header: MessageHeader, data: Vec<u8>) -> Result<(), Fail> {
        let given = self.ids.lock().unwrap().1;
        if channel >= given {
            return Err(bad(format!("channel {channel} is not one of the {given} that recorder_channel gave")));
        }
        let bytes = data.len() + 32;
        let pushed = self.push(Item::Message { channel, header, data }, bytes);
        if pushed.is_err() {
            self.shared.lost.fetch_add(1, Relaxed);
        }
        pushed
    }

    pub fn push(&self, item: Item, bytes: usize) -> Result<(), Fail> {
        self.queue.push(item, bytes).map_err(|(refused, _)| match refused {
            Refused::Full => {
                Fail::new(DROPPED, "the recorder's queue of 64 MiB is full, because the disk is slower than the recording")
            }
            Refused::Closed => Fail::new(CLOSED, "the recorder is closed"),
        })
    }

    pub fn lost(&self) -> u64 {
        self.shared.lost.load(Relaxed)
    }

    pub fn index(&self) -> u64 {
        self.shared.index.load(Relaxed)
    }

    pub fn trouble(&self) -> Option<&(i32, CString)> {
        self.shared.trouble.get()
    }

    pub fn close(self) -> Result<(), Fail> {
        self.queue.close();
        let ended = self.thread.join();
        match self.shared.trouble.get() {
            Some((status, sentence)) => Err(Fail::new(*status, sentence.to_string_lossy())),
            None if ended.is_err() => Err(Fail::new(IO, "the recorder's thread ended early")),
            None => Ok(()),
        }
    }
}

fn bad(sentence: String) -> Fail {
    Fail::new(BAD_ARGUMENT, sentence)
}

type Sink = Writer<NoSeek<BufWriter<File>>>;

/// The state of the writing thread.
struct Scribe {
    path: String,
    writer: Option<Sink>, // None after the first failure
    sync: File,
    shared: Arc<Shared>,
    schemas: Vec<u16>, // our ids -> ids in the file
    channels: Vec<Channel>,
    chunk: Chunk,
    unsynced: u64, // messages since the last sync; they are lost if the disk fails
    sync_at: Instant,
}

struct Channel {
    id: u16,         // id in the file
    last_chunk: u64, // the last chunk with a message of this channel
}

/// The chunk that mcap fills now, as far as it matters to the index.
struct Chunk {
    number: u64,
    bytes: u64,
}

impl Scribe {
    fn run(mut self, items: &Queue<Item>) {
        loop {
            match items.pop(Some(self.sync_at.saturating_duration_since(Instant::now()))) {
                Next::Item(item) => self.take(item),
                Next::TimedOut => {}
                Next::Closed => break,
            }
            let begun = Instant::now();
            if begun >= self.sync_at {
                self.attempt(|scribe, writer| {
                    scribe.end_chunk();
                    writer.flush()?;
                    scribe.synced()
                });
                // Counted from the begin of the sync: later messages have already waited.
                self.sync_at = (begun + SYNC_PERIOD).max(Instant::now() + SYNC_PAUSE);
            }
        }
        if let Some(mut writer) = self.writer.take() {
            let finished = writer.finish().and_then(|_| {
                writer.into_inner().into_inner().flush()?;
                self.synced()
            });
            if let Err(error) = finished {
                self.give_up(&error);
            }
        }
    }

    fn take(&mut self, item: Item) {
        self.unsynced += u64::from(matches!(item, Item::Message { .. }));
        if self.writer.is_none() {
            self.count_lost();
            return;
        }
        // Without these no part of a file can be used, so sync at once.
        if matches!(item, Item::Attachment { .. } | Item::Metadata { .. }) {
            self.sync_at = Instant::now();
        }
        self.attempt(|scribe, writer| scribe.write(writer, item));
    }

    /// Runs one step on the file if it is still sound. The first failure ends the file, because mcap cannot resume after one.
    fn attempt(&mut self, step: impl FnOnce(&mut Scribe, &mut Sink) -> McapResult<()>) {
        let Some(mut writer) = self.writer.take() else { return };
        match step(self, &mut writer) {
            Ok(()) => self.writer = Some(writer),
            Err(error) => self.give_up(&error),
        }
    }

    fn give_up(&mut self, error: &McapError) {
        self.count_lost();
        let path = &self.path;
        let why = causes(error);
        let sentence = format!(
            "{path}: the recording ends here: {why}; the data synced before is readable; record again in another place"
        );
        _ = self.shared.trouble.set((IO, CString::new(sentence.replace('\0', " ")).unwrap_or_default()));
    }

    fn count_lost(&mut self) {
        self.shared.lost.fetch_add(std::mem::take(&mut self.unsynced), Relaxed);
    }

    fn synced(&mut self) -> McapResult<()> {
        match self.sync.sync_data() {
            Err(error) if error.kind() != ErrorKind::InvalidInput => return Err(error.into()), // pipes cannot be synced
            _ => self.unsynced = 0,
        }
        Ok(())
    }

    /// mcap ends a full chunk before it adds the next message.
    fn count_in_index(&mut self, channel: usize, size: usize) {
        if self.chunk.bytes > CHUNK_BYTES {
            self.end_chunk();
        }
        let mut more = if self.chunk.bytes == 0 { INDEX_OF_CHUNK } else { 0 };
        self.chunk.bytes += MESSAGE_HEAD + size as u64;
        let last = &mut self.channels[channel].last_chunk;
        if *last != self.chunk.number {
            *last = self.chunk.number;
            more += INDEX_OF_CHANNEL_IN_CHUNK;
        }
        self.shared.index.fetch_add(more, Relaxed);
    }

    fn end_chunk(&mut self) {
        self.chunk = Chunk { number: self.chunk.number + 1, bytes: 0 };
    }

    fn write(&mut self, writer: &mut Sink, item: Item) -> McapResult<()> {
        match item {
            Item::Schema { name, bfbs } => self.schemas.push(writer.add_schema(&name, "flatbuffer", &bfbs)?),
            Item::Channel { topic, schema } => {
                let id = writer.add_channel(self.schemas[schema], &topic, "flatbuffer", &BTreeMap::new())?;
                self.channels.push(Channel { id, last_chunk: 0 });
                self.shared.index.fetch_add(INDEX_OF_CHANNEL + INDEX_OF_TOPIC * topic.len() as u64, Relaxed);
            }
            Item::Message { channel, header, data } => {
                self.count_in_index(channel, data.len());
                let header = MessageHeader { channel_id: self.channels[channel].id, ..header };
                writer.write_to_known_channel(&header, &data)?;
            }
            Item::Attachment { name, media_type, data } => {
                let attachment = Attachment { log_time: 0, create_time: 0, name, media_type, data: Cow::Owned(data) };
                writer.attach(&attachment)?;
            }
            Item::Metadata { name, pairs } => writer.write_metadata(&mcap::write::Metadata { name, metadata: pairs })?,
        }
        Ok(())
    }
}
