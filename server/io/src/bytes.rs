//! A byte buffer that starts at a 16-byte boundary: FlatBuffers are read in place, while zenoh and MCAP give slices at any
//! address. It never grows, so its address stays the same.

pub struct Aligned {
    store: Vec<u8>,
    start: usize,
}

/// No bytes, but still at an aligned address.
impl Default for Aligned {
    fn default() -> Aligned {
        Aligned::copy(&[])
    }
}

impl Aligned {
    const BOUNDARY: usize = 16;

    pub fn gather<'a>(size: usize, slices: impl Iterator<Item = &'a [u8]>) -> Aligned {
        let mut store: Vec<u8> = Vec::with_capacity(size + Self::BOUNDARY);
        let start = store.as_ptr().align_offset(Self::BOUNDARY);
        store.resize(start, 0);
        for slice in slices {
            let room = size - (store.len() - start);
            store.extend_from_slice(&slice[..slice.len().min(room)]);
        }
        Aligned { store, start }
    }

    pub fn copy(bytes: &[u8]) -> Aligned {
        Self::gather(bytes.len(), std::iter::once(bytes))
    }

    pub fn as_slice(&self) -> &[u8] {
        &self.store[self.start..]
    }
}
