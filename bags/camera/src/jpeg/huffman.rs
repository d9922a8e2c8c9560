//! Huffman tables of JPEG, and the bits of its scans (ITU-T T.81, annexes C and F).

use super::JpegError;

/// Longest code in the lookup table; longer codes are rare \[bits\].
const AHEAD: u32 = 10;
/// The step to the end of a block, larger than any other.
pub(super) const END: u8 = 128;
/// Longest AC coefficient of a sequential picture with 8-bit samples \[bits\] (T.81, F.1.2.2).
const MOST_AC_BITS: u8 = 10;
/// Longest code \[bits\].
const LONGEST: usize = 16;

/// A Huffman table, for decoding.
#[derive(Clone, Debug)]
pub(super) struct Table {
    /// Code length \[bits\] and symbol, by the next [`AHEAD`] bits; length 0 for longer codes.
    fast: Box<[(u8, u8); 1 << AHEAD]>,
    /// As `fast`: bits of code and value, and the step in a block of a sequential picture.
    steps: Box<[(u8, u8); 1 << AHEAD]>,
    /// By length - 1: the first code too large for this length, left-aligned to 16 bits.
    limit: [u32; LONGEST],
    /// By length - 1: offset from a code to the index of its symbol.
    offset: [i32; LONGEST],
    symbols: Vec<u8>,
}

impl Table {
    /// A table with `counts` codes of each length, and their symbols in code order.
    ///
    /// # Errors
    /// More codes than their lengths or symbols allow.
    pub(super) fn new(counts: &[u8; LONGEST], symbols: &[u8]) -> Result<Self, JpegError> {
        let invalid = || JpegError::Damaged("a Huffman table is invalid".to_owned());
        let mut table = Self {
            fast: Box::new([(0, 0); 1 << AHEAD]),
            steps: Box::new([(0, 0); 1 << AHEAD]),
            limit: [0; LONGEST],
            offset: [0; LONGEST],
            symbols: symbols.to_vec(),
        };
        let (mut code, mut place) = (0_u32, 0_usize);
        for (length, count) in (1_u32..).zip(counts) {
            let row = length as usize - 1;
            // Fits: both are below 2^17.
            if let Some(offset) = table.offset.get_mut(row) {
                *offset = place as i32 - code as i32;
            }
            for _ in 0..*count {
                let symbol = *symbols.get(place).ok_or_else(invalid)?;
                if code >> length != 0 {
                    return Err(invalid());
                }
                if length <= AHEAD {
                    let unused = AHEAD - length;
                    let first = (code << unused) as usize;
                    let codes = first..first + (1 << unused);
                    let fast = table.fast.get_mut(codes.clone()).ok_or_else(invalid)?;
                    fast.fill((length as u8, symbol));
                    let steps = table.steps.get_mut(codes).ok_or_else(invalid)?;
                    steps.fill(step(length, symbol));
                }
                (code, place) = (code + 1, place + 1);
            }
            if let Some(limit) = table.limit.get_mut(row) {
                *limit = code << (LONGEST as u32 - length);
            }
            code <<= 1;
        }
        Ok(table)
    }

    /// Length and symbol of the code at the upper bits of `ahead`.
    fn look_up(&self, ahead: u16) -> Result<(u32, u8), JpegError> {
        match self.fast.get(usize::from(ahead >> (16 - AHEAD))) {
            Some((length, symbol)) if *length > 0 => Ok((u32::from(*length), *symbol)),
            _ => self.look_up_long(ahead),
        }
    }

    #[cold]
    fn look_up_long(&self, ahead: u16) -> Result<(u32, u8), JpegError> {
        let rows = (1_u32..).zip(self.limit).zip(self.offset);
        for ((length, limit), offset) in rows.skip(AHEAD as usize) {
            if u32::from(ahead) < limit {
                let code = i32::from(ahead >> (LONGEST as u32 - length));
                let place = usize::try_from(code + offset).ok();
                let symbol = place.and_then(|place| self.symbols.get(place));
                return symbol.map(|symbol| (length, *symbol)).ok_or_else(bad_code);
            }
        }
        Err(bad_code())
    }
}

/// Bits of a code with its value, and the step in a block: [`END`] if no coefficient follows. 0 bits for too large values.
fn step(length: u32, symbol: u8) -> (u8, u8) {
    // Fits: at most 16.
    let length = length as u8;
    match (symbol >> 4, symbol & 15) {
        (15, 0) => (length, 16),
        (_, 0) => (length, END),
        (_, size) if size > MOST_AC_BITS => (0, 0),
        (zeros, size) => (length + size, zeros + 1),
    }
}

fn bad_code() -> JpegError {
    JpegError::Damaged("a Huffman code is invalid".to_owned())
}

/// Reads the bits between two markers.
#[derive(Debug)]
pub(super) struct Bits<'a> {
    data: &'a [u8],
    /// The next byte after the buffer.
    at: usize,
    /// The next bits, left-aligned, then zeros.
    buffer: u64,
    /// Number of bits in the buffer.
    count: u32,
}

impl<'a> Bits<'a> {
    /// The bits from byte `at`.
    pub(super) fn new(data: &'a [u8], at: usize) -> Self {
        Self {
            data,
            at,
            buffer: 0,
            count: 0,
        }
    }

    /// Fills the buffer to at least 32 bits, or up to the next marker.
    #[inline(always)]
    fn fill(&mut self) {
        if self.count >= 32 {
            return;
        }
        if let Some(Some(bytes)) = self.data.get(self.at..).map(<[u8]>::first_chunk::<4>) {
            let bytes = u32::from_be_bytes(*bytes);
            // Detects a byte 0xff: whether a byte of the complement is 0.
            let may_be_marker = (!bytes).wrapping_sub(0x0101_0101) & bytes & 0x8080_8080 != 0;
            if !may_be_marker {
                self.buffer |= u64::from(bytes) << (32 - self.count);
                self.count += 32;
                self.at += 4;
                return;
            }
        }
        self.fill_by_byte();
    }

    #[cold]
    fn fill_by_byte(&mut self) {
        while self.count <= 56 {
            let Some(byte) = self.data.get(self.at) else {
                return;
            };
            if *byte == 0xff {
                // In data, 0 follows 0xff.
                if self.data.get(self.at + 1) != Some(&0) {
                    return;
                }
                self.at += 1;
            }
            self.at += 1;
            self.buffer |= u64::from(*byte) << (56 - self.count);
            self.count += 8;
        }
    }

    /// Skips `number` bits, at most 31.
    #[inline]
    fn drop(&mut self, number: u32) -> Result<(), JpegError> {
        let left = self.count.checked_sub(number);
        self.count = left.ok_or(JpegError::Incomplete)?;
        self.buffer <<= number;
        Ok(())
    }

    #[inline]
    pub(super) fn symbol(&mut self, table: &Table) -> Result<u8, JpegError> {
        self.fill();
        let (length, symbol) = table.look_up((self.buffer >> 48) as u16)?;
        self.drop(length)?;
        Ok(symbol)
    }

    /// Skips a symbol and its value; returns the step in the block.
    #[inline(always)]
    pub(super) fn step(&mut self, table: &Table) -> Result<u8, JpegError> {
        self.fill();
        let (bits, step) = table.steps[(self.buffer >> (64 - AHEAD)) as usize & ((1 << AHEAD) - 1)];
        if bits == 0 {
            return self.long_step(table);
        }
        self.drop(u32::from(bits))?;
        Ok(step)
    }

    #[cold]
    fn long_step(&mut self, table: &Table) -> Result<u8, JpegError> {
        let (length, symbol) = table.look_up((self.buffer >> 48) as u16)?;
        let (bits, step) = step(length, symbol);
        if bits == 0 {
            return Err(JpegError::Damaged("a coefficient is too large".to_owned()));
        }
        self.drop(u32::from(bits))?;
        Ok(step)
    }

    /// Reads a difference of two DC coefficients.
    #[inline]
    pub(super) fn difference(&mut self, table: &Table) -> Result<i32, JpegError> {
        let size = self.symbol(table)?.min(15);
        let value = i32::from(self.value(size)?);
        // Values without the upper bit are negative.
        Ok(match size {
            0 => 0,
            _ if value >> (size - 1) == 0 => value - (1 << size) + 1,
            _ => value,
        })
    }

    /// Reads `number` bits, at most 15.
    #[inline]
    pub(super) fn value(&mut self, number: u8) -> Result<u16, JpegError> {
        self.fill();
        // In u32, since a shift by 16 must work.
        let value = (self.buffer >> 48 >> (16 - u32::from(number).min(16))) as u16;
        self.drop(u32::from(number))?;
        Ok(value)
    }

    /// The place of the next marker, and the number of unread whole bytes before it.
    pub(super) fn marker(&self) -> (usize, usize) {
        let mut unread = (self.count / 8) as usize;
        let mut at = self.at;
        while let Some(byte) = self.data.get(at) {
            if *byte == 0xff {
                match self.data.get(at + 1) {
                    Some(0) => at += 1,
                    // A marker may follow fill bytes of 0xff.
                    Some(0xff) => {
                        at += 1;
                        continue;
                    }
                    _ => break,
                }
            }
            unread += 1;
            at += 1;
        }
        (at, unread)
    }
}

/// The tables of annex K: id and class as in a DHT segment, code counts by length, symbols.
const STANDARD: [(u8, &[u8; LONGEST], &[u8]); 4] = [
    (0x00, &DC_LUMA, &DC_SYMBOLS),
    (0x01, &DC_CHROMA, &DC_SYMBOLS),
    (0x10, &AC_LUMA, &AC_LUMA_SYMBOLS),
    (0x11, &AC_CHROMA, &AC_CHROMA_SYMBOLS),
];

/// The standard table with this id and class; motion JPEG uses them without sending them.
pub(super) fn standard(id: u8) -> Option<Table> {
    let (_, counts, symbols) = STANDARD.into_iter().find(|(own, ..)| *own == id)?;
    Table::new(counts, symbols).ok()
}

/// A DHT segment with all standard tables.
pub(super) fn standard_segment() -> Vec<u8> {
    let mut body = Vec::new();
    for (id, counts, symbols) in STANDARD {
        body.push(id);
        body.extend(counts);
        body.extend(symbols);
    }
    // Fits: 418 bytes and the length itself.
    let length = (body.len() + 2) as u16;
    let mut segment = vec![0xff, 0xc4];
    segment.extend(length.to_be_bytes());
    segment.extend(body);
    segment
}

const DC_LUMA: [u8; 16] = [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0];
const DC_CHROMA: [u8; 16] = [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0];
const DC_SYMBOLS: [u8; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];
const AC_LUMA: [u8; 16] = [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125];
const AC_CHROMA: [u8; 16] = [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 119];
const AC_LUMA_SYMBOLS: [u8; 162] = [
    0x1, 0x2, 0x3, 0x0, 0x4, 0x11, 0x5, 0x12, 0x21, 0x31, 0x41, 0x6, 0x13, 0x51, 0x61, 0x7, 0x22,
    0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x8, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0, 0x24,
    0x33, 0x62, 0x72, 0x82, 0x9, 0xa, 0x16, 0x17, 0x18, 0x19, 0x1a, 0x25, 0x26, 0x27, 0x28, 0x29,
    0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4a,
    0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a,
    0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a,
    0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8,
    0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5, 0xc6,
    0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe1, 0xe2, 0xe3,
    0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9,
    0xfa,
];
const AC_CHROMA_SYMBOLS: [u8; 162] = [
    0x0, 0x1, 0x2, 0x3, 0x11, 0x4, 0x5, 0x21, 0x31, 0x6, 0x12, 0x41, 0x51, 0x7, 0x61, 0x71, 0x13,
    0x22, 0x32, 0x81, 0x8, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1, 0x9, 0x23, 0x33, 0x52, 0xf0, 0x15,
    0x62, 0x72, 0xd1, 0xa, 0x16, 0x24, 0x34, 0xe1, 0x25, 0xf1, 0x17, 0x18, 0x19, 0x1a, 0x26, 0x27,
    0x28, 0x29, 0x2a, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49,
    0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69,
    0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88,
    0x89, 0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6,
    0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4,
    0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe2,
    0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9,
    0xfa,
];
