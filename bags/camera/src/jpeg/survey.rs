//! Examines all segments and scans of a JPEG: its layout, and that it is complete.

use super::{
    JpegError,
    frame::{Colours, Frame},
    huffman::{Table, standard},
    scan::{COEFFICIENTS, NonZero, Scan, ScanComponent, check_scan},
};

/// Limit of scans, each of which reads all blocks; encoders write at most 14.
const SCANS_LIMIT: usize = 100;
/// Marks a coefficient that no scan has sent.
const NOT_SENT: u8 = u8::MAX;

/// The layout of a complete JPEG.
#[derive(Debug)]
pub(super) struct Survey {
    pub frame: Frame,
    pub colours: Colours,
    pub scans: usize,
    /// Whether it uses the standard tables without sending them.
    pub needs_standard_tables: bool,
    /// Size with the end marker \[bytes\].
    pub length: usize,
}

/// Tables and settings of the segments so far.
#[derive(Debug, Default)]
struct State {
    frame: Option<Frame>,
    dc: [Option<Table>; 4],
    ac: [Option<Table>; 4],
    /// The DC step of each quantisation table.
    dc_steps: [Option<u16>; 4],
    restart_interval: u32,
    is_jfif: bool,
    adobe: Option<u8>,
    needs_standard_tables: bool,
    scans: usize,
    non_zero: Vec<NonZero>,
    /// By component and coefficient: number of low bits that no scan has sent.
    missing_bits: Vec<[u8; COEFFICIENTS]>,
}

/// Examines a JPEG.
pub(super) fn survey(data: &[u8]) -> Result<Survey, JpegError> {
    let mut state = State::default();
    // After the start marker, which the caller has checked.
    let mut at = 2;
    loop {
        let (kind, body) = marker(data, at)?;
        if kind == 0xd9 {
            return state.finish(body);
        }
        let (segment, after) = segment(data, body)?;
        at = match kind {
            0xda => state.scan(data, segment, after)?,
            _ => {
                state.segment(kind, segment)?;
                after
            }
        };
    }
}

/// The kind of the marker at `at`, and the place after it.
fn marker(data: &[u8], mut at: usize) -> Result<(u8, usize), JpegError> {
    if *data.get(at).ok_or(JpegError::Incomplete)? != 0xff {
        return Err(JpegError::Damaged(format!(
            "expected a marker at byte {at}"
        )));
    }
    // A marker may follow fill bytes of 0xff.
    loop {
        at += 1;
        match *data.get(at).ok_or(JpegError::Incomplete)? {
            0xff => {}
            0 | 0xd0..=0xd7 => {
                return Err(JpegError::Damaged(format!(
                    "the marker before byte {at} is not expected there"
                )));
            }
            kind => return Ok((kind, at + 1)),
        }
    }
}

/// The content of the segment with its length at `at`, and the place after it.
fn segment(data: &[u8], at: usize) -> Result<(&[u8], usize), JpegError> {
    let rest = data.get(at..).ok_or(JpegError::Incomplete)?;
    let (length, _) = rest.split_first_chunk().ok_or(JpegError::Incomplete)?;
    let length = usize::from(u16::from_be_bytes(*length));
    if length < 2 {
        return Err(JpegError::Damaged(format!(
            "the segment at byte {at} has a length of {length}"
        )));
    }
    let segment = rest.get(2..length).ok_or(JpegError::Incomplete)?;
    Ok((segment, at + length))
}

fn damaged(what: &str) -> JpegError {
    JpegError::Damaged(format!("{what} is invalid"))
}

impl State {
    fn segment(&mut self, kind: u8, segment: &[u8]) -> Result<(), JpegError> {
        match kind {
            0xc4 => self.huffman_tables(segment),
            0xcc => Err(JpegError::Layout("arithmetic coding")),
            0xc0..=0xcf => self.frame(kind, segment),
            0xdb => self.quantisation_tables(segment),
            0xdd => {
                let interval = <[u8; 2]>::try_from(segment);
                let interval = interval.map_err(|_| damaged("its restart interval"))?;
                self.restart_interval = u32::from(u16::from_be_bytes(interval));
                Ok(())
            }
            0xe0 if segment.starts_with(b"JFIF\0") => {
                self.is_jfif = true;
                Ok(())
            }
            0xee if segment.starts_with(b"Adobe") => {
                // After version and two words of flags.
                self.adobe = segment.get(11).copied();
                Ok(())
            }
            0xe0..=0xef | 0xfe => Ok(()),
            _ => Err(JpegError::Damaged(format!(
                "the segment of marker {kind:#04x} is unknown"
            ))),
        }
    }

    fn frame(&mut self, kind: u8, segment: &[u8]) -> Result<(), JpegError> {
        if self.frame.is_some() {
            return Err(JpegError::Layout("several frames"));
        }
        let frame = Frame::read(kind, segment)?;
        self.non_zero = vec![NonZero::new(); frame.components.len()];
        self.missing_bits = vec![[NOT_SENT; COEFFICIENTS]; frame.components.len()];
        self.frame = Some(frame);
        Ok(())
    }

    fn huffman_tables(&mut self, mut segment: &[u8]) -> Result<(), JpegError> {
        let invalid = || damaged("its segment of Huffman tables");
        while !segment.is_empty() {
            let (&[id], rest) = segment.split_first_chunk().ok_or_else(invalid)?;
            let (counts, rest) = rest.split_first_chunk::<16>().ok_or_else(invalid)?;
            let total = counts.iter().map(|count| usize::from(*count)).sum();
            let (symbols, rest) = rest.split_at_checked(total).ok_or_else(invalid)?;
            let tables = match id >> 4 {
                // Differences of 8-bit samples have at most 11 bits.
                0 if symbols.iter().all(|symbol| *symbol < 16) => &mut self.dc,
                1 => &mut self.ac,
                _ => return Err(invalid()),
            };
            let table = tables.get_mut(usize::from(id & 15)).ok_or_else(invalid)?;
            *table = Some(Table::new(counts, symbols)?);
            segment = rest;
        }
        Ok(())
    }

    fn quantisation_tables(&mut self, mut segment: &[u8]) -> Result<(), JpegError> {
        let invalid = || damaged("its segment of quantisation tables");
        while !segment.is_empty() {
            let (&[id, high, low], _) = segment.split_first_chunk().ok_or_else(invalid)?;
            let (bytes, dc_step) = match id >> 4 {
                0 => (COEFFICIENTS, u16::from(high)),
                1 => (2 * COEFFICIENTS, u16::from_be_bytes([high, low])),
                _ => return Err(invalid()),
            };
            let (_, rest) = segment.split_at_checked(1 + bytes).ok_or_else(invalid)?;
            let step = self.dc_steps.get_mut(usize::from(id & 15));
            *step.ok_or_else(invalid)? = Some(dc_step);
            segment = rest;
        }
        Ok(())
    }

    /// Checks a scan with its data at `at`; returns the place of the next marker.
    fn scan(&mut self, data: &[u8], segment: &[u8], at: usize) -> Result<usize, JpegError> {
        let invalid = || damaged("the header of a scan");
        self.scans += 1;
        if self.scans > SCANS_LIMIT {
            return Err(JpegError::Layout("more than 100 scans"));
        }
        let (&[number], rest) = segment.split_first_chunk().ok_or_else(invalid)?;
        let (selectors, rest) = rest
            .split_at_checked(usize::from(number) * 2)
            .ok_or_else(invalid)?;
        let &[first, last, bits] = rest else {
            return Err(invalid());
        };
        let selected = self.read_selectors(selectors.as_chunks::<2>().0)?;
        let frame = self.frame.as_ref().ok_or_else(invalid)?;
        let (band, bits) = if frame.is_progressive {
            ((first, last), (bits >> 4, bits & 15))
        } else {
            // Some encoders leave these bytes 0 in sequential pictures, which do not need them.
            ((0, 63), (0, 0))
        };
        let is_dc_alone = band == (0, 0);
        let is_ac_of_one = band.0 > 0 && band.0 <= band.1 && selected.len() == 1;
        let is_refining = bits.0 > 0;
        let fits = !frame.is_progressive
            || (is_dc_alone || is_ac_of_one)
                && band.1 < 64
                && bits.1 <= 13
                && (!is_refining || bits.0 == bits.1 + 1);
        if !fits {
            return Err(invalid());
        }
        self.record_coefficients(&selected, band, bits)?;
        let uses_dc = band.0 == 0 && !is_refining;
        let uses_ac = band.1 > 0;
        self.add_standard_tables(&selected, uses_dc, uses_ac);
        let frame = self.frame.as_ref().ok_or_else(invalid)?;
        let part = |(component, dc, ac): &(usize, u8, u8)| {
            let quantisation = frame.components.get(*component).map(|c| c.quantisation);
            let dc_step = self
                .dc_steps
                .get(usize::from(quantisation?))
                .copied()
                .flatten();
            Some(ScanComponent {
                component: *component,
                dc: self.dc.get(usize::from(*dc)).and_then(Option::as_ref),
                ac: self.ac.get(usize::from(*ac)).and_then(Option::as_ref),
                dc_step: i32::from(dc_step?),
            })
        };
        let components: Option<Vec<_>> = selected.iter().map(part).collect();
        let scan = Scan {
            components: components
                .ok_or_else(|| JpegError::Damaged("a quantisation table is missing".to_owned()))?,
            band,
            bits,
            restart_interval: self.restart_interval,
        };
        check_scan(data, at, frame, &scan, &mut self.non_zero)
    }

    /// The components of a scan, and the ids of their DC and AC tables.
    fn read_selectors(&self, selectors: &[[u8; 2]]) -> Result<Vec<(usize, u8, u8)>, JpegError> {
        let invalid = || damaged("the header of a scan");
        let frame = self.frame.as_ref().ok_or_else(invalid)?;
        let mut selected: Vec<(usize, u8, u8)> = Vec::new();
        let mut blocks = 0;
        for [id, tables] in selectors {
            let mut components = frame.components.iter().enumerate();
            let (component, found) = components.find(|(_, c)| c.id == *id).ok_or_else(invalid)?;
            if selected.iter().any(|(other, ..)| *other == component) {
                return Err(invalid());
            }
            blocks += u32::from(found.factors.0) * u32::from(found.factors.1);
            selected.push((component, tables >> 4, tables & 15));
        }
        // T.81, B.2.3.
        if selected.is_empty() || selected.len() > 1 && blocks > 10 {
            return Err(invalid());
        }
        Ok(selected)
    }

    /// Records which coefficients a scan sends.
    fn record_coefficients(
        &mut self,
        selected: &[(usize, u8, u8)],
        band: (u8, u8),
        bits: (u8, u8),
    ) -> Result<(), JpegError> {
        for (component, ..) in selected {
            let missing = self.missing_bits.get_mut(*component);
            let missing = missing.ok_or_else(|| damaged("the header of a scan"))?;
            let band = usize::from(band.0)..=usize::from(band.1);
            for missing in missing.get_mut(band).into_iter().flatten() {
                let expected = match bits.0 {
                    0 => NOT_SENT,
                    bits => bits,
                };
                if *missing != expected {
                    return Err(JpegError::Incomplete);
                }
                *missing = bits.1;
            }
        }
        Ok(())
    }

    /// Adds the standard tables if they are missing, as in motion JPEG.
    fn add_standard_tables(&mut self, selected: &[(usize, u8, u8)], uses_dc: bool, uses_ac: bool) {
        for (_, dc, ac) in selected {
            for (tables, number, is_used, kind) in [
                (&mut self.dc, *dc, uses_dc, 0x00),
                (&mut self.ac, *ac, uses_ac, 0x10),
            ] {
                if let (true, Some(table @ None)) = (is_used, tables.get_mut(usize::from(number))) {
                    *table = standard(kind | number);
                    self.needs_standard_tables |= table.is_some();
                }
            }
        }
    }

    fn finish(self, length: usize) -> Result<Survey, JpegError> {
        let frame = self.frame.ok_or(JpegError::Incomplete)?;
        let mut missing = self.missing_bits.iter().flatten();
        if missing.any(|bits| *bits != 0) {
            return Err(JpegError::Incomplete);
        }
        Ok(Survey {
            colours: frame.colours(self.is_jfif, self.adobe),
            frame,
            scans: self.scans,
            needs_standard_tables: self.needs_standard_tables,
            length,
        })
    }
}
