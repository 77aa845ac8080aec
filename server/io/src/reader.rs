//! Reads an MCAP file that may be whole, cut off at any byte, damaged or hostile. Gives its messages in file order, its
//! attachments and its metadata. A first pass steps over the records by their lengths and finds the end of the last whole
//! record. Then only that part is streamed, with one chunk in memory; every chunk's checksum is verified.

use crate::bytes::Aligned;
use crate::fail::{BAD_FILE, Fail, IO, causes};
use mcap::MAGIC;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::HashMap;
use std::ffi::CString;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom, Take};
use std::rc::Rc;

/// Most bytes of one record in memory: protects against the lengths that a damaged or hostile file claims.
const MAX_RECORD: u64 = 256 << 20;
const RECORD_HEAD: u64 = 9; // opcode, length
/// Most bytes of an unpacked chunk. Ours have 256 KiB and a message, those of the mcap tool 4 MiB; the longest recorded message
/// has 32 MiB.
const MAX_CHUNK: u64 = 64 << 20;
/// Most bytes that a chunk unpacks to, per byte of its size. LZ4 gives at most 255; zstd up to 32,000, but not for a tick's
/// data.
const MAX_RATIO: u64 = 256;
const CHUNK_HEAD: usize = 24; // two times, the claimed unpacked size
/// Most bytes of schemas and channels, which are kept to the end: ours take 20 kB, and 60,000 channels 6 MB.
const MAX_NAMES: usize = 64 << 20;

pub struct Attachment {
    pub name: CString,
    pub media_type: CString,
    pub data: Aligned,
}

pub struct Metadata {
    pub name: CString,
    pub pairs: Vec<CString>, // key, value, key, value, ...
}

#[derive(Default, PartialEq, Eq)]
pub struct Schema {
    pub name: CString,
    pub data: Vec<u8>, // .bfbs
}

pub struct Message<'a> {
    pub topic: &'a CString,
    pub schema: &'a Schema,
    pub data: &'a [u8],
    pub sequence: u32,
    pub log_time: u64,
    pub publish_time: u64,
}

pub struct Reader {
    path: String,
    contents: Contents,
    stream: Stream,
    schemas: HashMap<u16, Rc<Schema>>,
    channels: HashMap<u16, (CString, Rc<Schema>)>, // topic, schema
    names: usize,                                  // bytes of all declarations so far, including replaced ones
    current: Aligned,
    failed: Option<Fail>,
}

impl Reader {
    pub fn open(path: &str) -> Result<Reader, Fail> {
        let unreadable =
            |e: std::io::Error| Fail::new(IO, format!("{path}: cannot be read ({e}); check the name and permissions"));
        let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
        let contents = Contents::survey(&mut file).map_err(|trouble| match trouble {
            Trouble::Io(e) => unreadable(e),
            Trouble::Bad(what) => Fail::new(BAD_FILE, format!("{path}: {what}")),
        })?;
        let stream = Stream::start(file, &contents).map_err(unreadable)?;
        let path = path.to_string();
        Ok(Reader {
            path,
            contents,
            stream,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            names: 0,
            current: Aligned::default(),
            failed: None,
        })
    }

    pub fn is_cut(&self) -> bool {
        self.contents.cut
    }

    pub fn attachments(&self) -> &[Attachment] {
        &self.contents.attachments
    }

    pub fn metadata(&self) -> &[Metadata] {
        &self.contents.metadata
    }

    pub fn rewind(&mut self) -> Result<(), Fail> {
        self.failed = None;
        self.schemas.clear();
        self.channels.clear();
        self.names = 0;
        self.stream.restart(&self.contents).map_err(|e| Fail::new(IO, format!("{}: cannot be read ({e})", self.path)))
    }

    /// After a failure always returns the same failure: what follows a damaged record cannot be trusted.
    pub fn next(&mut self) -> Result<Option<Message<'_>>, Fail> {
        if let Some(fail) = &self.failed {
            return Err(fail.clone());
        }
        match self.advance() {
            Ok(None) => Ok(None),
            Ok(Some(header)) => {
                let (topic, schema) = &self.channels[&header.channel_id]; // advance() has checked it
                let (sequence, log_time, publish_time) = (header.sequence, header.log_time, header.publish_time);
                Ok(Some(Message { topic, schema, data: self.current.as_slice(), sequence, log_time, publish_time }))
            }
            Err(what) => Err(self.damaged(what)),
        }
    }

    fn damaged(&mut self, what: String) -> Fail {
        let path = &self.path;
        let fail = Fail::new(
            BAD_FILE,
            format!("{path}: damaged: {what}; the messages before it are sound, record or copy the file anew"),
        );
        self.failed.insert(fail).clone()
    }

    /// Streams to the next message and records schemas and channels on the way.
    fn advance(&mut self) -> Result<Option<mcap::records::MessageHeader>, String> {
        while let Some(event) = self.stream.linear.next_event() {
            match event.map_err(|e| causes(&e))? {
                LinearReadEvent::ReadRequest(need) => {
                    // A record in a chunk may claim any length: allocate no more than the file still has.
                    let need = need.min(self.stream.file.limit() as usize).max(1);
                    let got = self.stream.file.read(self.stream.linear.insert(need)).map_err(|e| e.to_string())?;
                    self.stream.linear.notify_read(got);
                }
                LinearReadEvent::Record { data, opcode: opcode @ (op::SCHEMA | op::CHANNEL | op::MESSAGE) } => {
                    match parse(opcode, data)? {
                        Record::Schema { header, data } => {
                            let schema = Rc::new(Schema { name: c_string(header.name), data: data.into_owned() });
                            if self.schemas.get(&header.id) != Some(&schema) {
                                self.names += schema.name.count_bytes() + schema.data.len();
                                self.schemas.insert(header.id, schema);
                            }
                        }
                        Record::Channel(channel) => {
                            let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                            let declared = (c_string(channel.topic), schema);
                            if self.channels.get(&channel.id) != Some(&declared) {
                                self.names += declared.0.count_bytes();
                                self.channels.insert(channel.id, declared);
                            }
                        }
                        Record::Message { header, .. } if !self.channels.contains_key(&header.channel_id) => {
                            let (message, channel) = (header.sequence, header.channel_id);
                            return Err(format!("message {message} is on channel {channel}, which the file never declared"));
                        }
                        Record::Message { header, data } => {
                            self.current = Aligned::copy(&data);
                            return Ok(Some(header));
                        }
                        _ => {}
                    }
                    if self.names > MAX_NAMES {
                        return Err(format!("its schemas and channels take over {} MiB", MAX_NAMES >> 20));
                    }
                }
                LinearReadEvent::Record { .. } => {}
            }
        }
        match &self.contents.damage {
            Some(what) => Err(what.clone()),
            None => Ok(None),
        }
    }
}

struct Stream {
    file: Take<BufReader<File>>,
    linear: LinearReader,
}

impl Stream {
    fn start(file: BufReader<File>, contents: &Contents) -> std::io::Result<Stream> {
        let mut stream = Stream { file: file.take(0), linear: LinearReader::new() };
        stream.restart(contents)?;
        Ok(stream)
    }

    fn restart(&mut self, contents: &Contents) -> std::io::Result<()> {
        self.file.get_mut().seek(SeekFrom::Start(0))?;
        self.file.set_limit(contents.end);
        // A prefix of the magic has no records; the reader must not wait for the rest of the magic.
        self.linear = LinearReader::new_with_options(
            LinearReaderOptions::default()
                .with_skip_start_magic(contents.end == 0)
                .with_skip_end_magic(true)
                .with_prevalidate_chunk_crcs(true)
                .with_validate_data_section_crc(!contents.cut && contents.damage.is_none())
                .with_record_length_limit(MAX_RECORD as usize),
        );
        Ok(())
    }
}

enum Trouble {
    Io(std::io::Error),
    Bad(String),
}

impl From<std::io::Error> for Trouble {
    fn from(error: std::io::Error) -> Trouble {
        Trouble::Io(error)
    }
}

/// Results of the first pass. The data section ends at `end`: after its end record, or after the last whole record.
#[derive(Default)]
struct Contents {
    end: u64,
    cut: bool,
    damage: Option<String>,
    attachments: Vec<Attachment>,
    metadata: Vec<Metadata>,
}

impl Contents {
    fn survey(file: &mut BufReader<File>) -> Result<Contents, Trouble> {
        let length = file.seek(SeekFrom::End(0))?;
        file.seek(SeekFrom::Start(0))?;
        let mut magic = Vec::new();
        file.by_ref().take(MAGIC.len() as u64).read_to_end(&mut magic)?;
        if !MAGIC.starts_with(&magic) {
            return Err(Trouble::Bad("this is not an MCAP recording (it begins with other bytes); name a .mcap file".into()));
        }
        let mut contents = Contents { cut: true, ..Contents::default() };
        if magic.len() < MAGIC.len() {
            return Ok(contents);
        }
        contents.end = MAGIC.len() as u64;
        let mut at = contents.end;
        let mut in_data = true;
        while let Some((opcode, size)) = record_head(file, length - at)? {
            if matches!(opcode, op::ATTACHMENT | op::METADATA) && in_data {
                if size > MAX_RECORD {
                    return Err(Trouble::Bad(format!("a record of {size} bytes is over the limit of {MAX_RECORD}")));
                }
                let mut body = Vec::new();
                file.by_ref().take(size).read_to_end(&mut body)?;
                if let Err(what) = contents.keep(opcode, &body) {
                    contents.damage = Some(what);
                    contents.cut = false;
                    return Ok(contents);
                }
            } else if opcode == op::CHUNK && in_data && size > CHUNK_HEAD as u64 {
                let mut head = [0u8; CHUNK_HEAD];
                file.read_exact(&mut head)?;
                let holds = head.last_chunk().map_or(0, |size| u64::from_le_bytes(*size));
                if holds > MAX_CHUNK || holds / MAX_RATIO > size {
                    contents.damage = Some(format!(
                        "the chunk at byte {at} claims to hold {holds} bytes in {size}: at most {} MiB are allowed, and at most \
                         {MAX_RATIO} times its size, which LZ4 never exceeds",
                        MAX_CHUNK >> 20
                    ));
                    contents.cut = false;
                    return Ok(contents);
                }
                file.seek_relative((size - CHUNK_HEAD as u64) as i64)?;
            } else {
                file.seek_relative(size as i64)?;
            }
            at += RECORD_HEAD + size;
            if in_data {
                contents.end = at;
            }
            in_data &= opcode != op::DATA_END;
            if opcode == op::FOOTER {
                contents.cut = length - at < MAGIC.len() as u64;
                break;
            }
        }
        // A cut file does not end with the magic bytes. A file that does contains a wrong length.
        if contents.cut && ends_in_magic(file, length)? {
            contents.cut = false;
            contents.damage = Some(format!("the record at byte {at} claims more bytes than the file has"));
        }
        Ok(contents)
    }

    fn keep(&mut self, opcode: u8, body: &[u8]) -> Result<(), String> {
        if opcode == op::METADATA {
            if let Record::Metadata(entry) = parse(opcode, body)? {
                let pairs = entry.metadata.into_iter().flat_map(|(key, value)| [c_string(key), c_string(value)]).collect();
                self.metadata.push(Metadata { name: c_string(entry.name), pairs });
            }
            return Ok(());
        }
        if let Record::Attachment { header, data, .. } = parse(opcode, body)? {
            let (name, media_type) = (c_string(header.name), c_string(header.media_type));
            self.attachments.push(Attachment { name, media_type, data: Aligned::copy(&data) });
        }
        Ok(())
    }
}

/// Opcode and length of the next record, if all of it lies within the `left` bytes. No record has opcode 0: zeros are a tail
/// that file systems leave after a power failure.
fn record_head(file: &mut BufReader<File>, left: u64) -> std::io::Result<Option<(u8, u64)>> {
    if left < RECORD_HEAD {
        return Ok(None);
    }
    let mut head = [0u8; RECORD_HEAD as usize];
    file.read_exact(&mut head)?;
    let size = u64::from_le_bytes([head[1], head[2], head[3], head[4], head[5], head[6], head[7], head[8]]);
    Ok((head[0] != 0 && size <= left - RECORD_HEAD).then_some((head[0], size)))
}

fn ends_in_magic(file: &mut BufReader<File>, length: u64) -> std::io::Result<bool> {
    let size = MAGIC.len() as u64;
    if length < 2 * size {
        return Ok(false);
    }
    file.seek(SeekFrom::Start(length - size))?;
    let mut tail = Vec::new();
    file.by_ref().take(size).read_to_end(&mut tail)?;
    Ok(tail == MAGIC)
}

/// mcap 0.26 allocates as many bytes as a string's length claims, up to 4 GiB, and slices `body[..size - 4]` of an attachment,
/// before it checks that they exist. So this checks the lengths first.
fn lengths_fit(opcode: u8, body: &[u8]) -> bool {
    let (numbers, strings) = match opcode {
        op::SCHEMA => (2, 2),      // id; name, encoding
        op::CHANNEL => (4, 2),     // id, schema; topic, encoding
        op::ATTACHMENT => (16, 2), // log time, create time; name, media type
        op::METADATA => (0, 1),    // name
        _ => return true,
    };
    let rest = body.get(numbers..).and_then(|rest| after_strings(rest, strings));
    match (opcode, rest) {
        (_, None) => false,
        (op::SCHEMA, _) => true, // mcap checks its data
        (op::ATTACHMENT, Some(rest)) => {
            let length = rest.split_first_chunk::<8>(); // then data and a checksum of 4 bytes
            length.is_some_and(|(length, after)| after.len() >= 4 && u64::from_le_bytes(*length) == after.len() as u64 - 4)
        }
        (_, Some(rest)) => {
            // a map: its length, then keys and values until it is reached
            let Some((length, mut rest)) = rest.split_first_chunk::<4>() else { return false };
            let end = rest.len().saturating_sub(u32::from_le_bytes(*length) as usize);
            while rest.len() > end {
                let Some(after) = after_strings(rest, 2) else { return false };
                rest = after;
            }
            true
        }
    }
}

/// The bytes after `count` strings, each of which is a u32 length and its bytes.
fn after_strings(mut rest: &[u8], count: usize) -> Option<&[u8]> {
    for _ in 0..count {
        let (length, after) = rest.split_first_chunk::<4>()?;
        rest = after.get(u32::from_le_bytes(*length) as usize..)?;
    }
    Some(rest)
}

fn parse(opcode: u8, body: &[u8]) -> Result<Record<'_>, String> {
    if !lengths_fit(opcode, body) {
        return Err(format!("the lengths in a record of kind {opcode} do not fit it"));
    }
    mcap::parse_record(opcode, body).map_err(|e| causes(&e))
}

/// C strings end at the first zero byte, so a name that contains one is cut off there.
fn c_string(text: String) -> CString {
    let mut bytes = text.into_bytes();
    bytes.truncate(bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len()));
    CString::new(bytes).unwrap_or_default()
}
