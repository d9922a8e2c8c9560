//! Checks that the coded data of a scan is complete (ITU-T T.81, annexes F and G).

use super::{
    JpegError,
    frame::Frame,
    huffman::{Bits, END, Table},
};

/// Limit of unread bytes between the last block and the next marker: webcam drivers append a few. Half a unit's bytes at
/// most: more would be blocks.
const MOST_UNREAD: usize = 8;
/// Largest DC coefficient \[8 levels\]: 1024 for black or white, with a margin for rounding.
const MOST_DC: i32 = 1100;
/// Number of coefficients in a block.
pub(super) const COEFFICIENTS: usize = 64;

/// A component of a scan.
#[derive(Debug)]
pub(super) struct ScanComponent<'a> {
    /// Index in the frame.
    pub component: usize,
    /// Tables, if the scan needs them.
    pub dc: Option<&'a Table>,
    pub ac: Option<&'a Table>,
    /// Quantisation step of the DC coefficient \[levels\].
    pub dc_step: i32,
}

/// The parameters of a scan.
#[derive(Debug)]
pub(super) struct Scan<'a> {
    pub components: Vec<ScanComponent<'a>>,
    /// First and last coefficient of a block.
    pub band: (u8, u8),
    /// Number of low bits that earlier scans have not sent (0: first scan of a coefficient), and that this one does not send.
    pub bits: (u8, u8),
    /// Units between restart markers; 0 without them.
    pub restart_interval: u32,
}

/// A bit for each non-zero coefficient of a component's blocks, which determines the data of a refining scan. Empty before
/// the first progressive scan.
pub(super) type NonZero = Vec<u64>;

/// Coding of a block's data.
#[derive(Clone, Copy)]
enum Coding {
    Sequential,
    FirstDc,
    RefinedDc,
    FirstAc,
    RefinedAc,
}

/// Checks the data from byte `at`; returns the place of the next marker.
///
/// # Errors
/// [`JpegError::Incomplete`] if blocks are missing; [`JpegError::Damaged`] for unread data or invalid codes.
pub(super) fn check_scan(
    data: &[u8],
    at: usize,
    frame: &Frame,
    scan: &Scan<'_>,
    non_zero: &mut [NonZero],
) -> Result<usize, JpegError> {
    let coding = match (frame.is_progressive, scan.band.0, scan.bits.0) {
        (false, ..) => Coding::Sequential,
        (true, 0, 0) => Coding::FirstDc,
        (true, 0, _) => Coding::RefinedDc,
        (true, _, 0) => Coding::FirstAc,
        (true, ..) => Coding::RefinedAc,
    };
    // Tables and number of blocks per unit, by component.
    let mut parts = Vec::new();
    for part in &scan.components {
        let component = frame
            .components
            .get(part.component)
            .ok_or_else(missing_component)?;
        let blocks = match scan.components.len() {
            1 => 1,
            _ => u32::from(component.factors.0) * u32::from(component.factors.1),
        };
        parts.push((part, blocks));
    }
    let (across, down) = match parts.as_slice() {
        [(only, _)] => frame.blocks(
            frame
                .components
                .get(only.component)
                .ok_or_else(missing_component)?,
        ),
        _ => frame.units(),
    };
    let mut walk = ScanReader {
        bits: Bits::new(data, at),
        begin: at,
        units: 0,
        band: scan.band,
        low_bits: scan.bits.1,
        run: 0,
        dc: [0; 4],
    };
    let mut masks = match scan.components.as_slice() {
        [only] if scan.band.0 > 0 => {
            let masks = non_zero
                .get_mut(only.component)
                .ok_or_else(missing_component)?;
            masks.resize(across as usize * down as usize, 0);
            masks.as_mut_slice()
        }
        _ => &mut [],
    }
    .iter_mut();
    for unit in 0..across * down {
        if scan.restart_interval > 0 && unit > 0 && unit % scan.restart_interval == 0 {
            let number = (unit / scan.restart_interval - 1) % 8;
            // Fits: below 8.
            walk.restart(data, number as u8)?;
        }
        walk.units += 1;
        for (number, (part, blocks)) in parts.iter().enumerate() {
            for _ in 0..*blocks {
                match coding {
                    Coding::Sequential => walk.sequential(part, number)?,
                    Coding::FirstDc => walk.dc(part, number)?,
                    Coding::RefinedDc => {
                        walk.bits.value(1)?;
                    }
                    Coding::FirstAc => {
                        let mask = masks.next().ok_or_else(missing_component)?;
                        walk.first(part.ac.ok_or_else(missing_table)?, mask)?;
                    }
                    Coding::RefinedAc => {
                        let mask = masks.next().ok_or_else(missing_component)?;
                        walk.refine(part.ac.ok_or_else(missing_table)?, mask)?;
                    }
                }
            }
        }
    }
    walk.end()
}

fn missing_component() -> JpegError {
    JpegError::Damaged("a scan names a component that is not there".to_owned())
}

fn missing_table() -> JpegError {
    JpegError::Damaged("a Huffman table is missing".to_owned())
}

fn too_many_coefficients() -> JpegError {
    JpegError::Damaged("a block has more than 64 coefficients".to_owned())
}

struct ScanReader<'a> {
    bits: Bits<'a>,
    /// Start of the data since the last restart, and the number of units in it.
    begin: usize,
    units: usize,
    band: (u8, u8),
    /// Number of low bits that the scan does not send.
    low_bits: u8,
    /// Number of further blocks without coefficients in the band.
    run: u32,
    /// The last DC coefficient of each component.
    dc: [i32; 4],
}

impl<'a> ScanReader<'a> {
    /// The place of the marker after the last block.
    fn end(&self) -> Result<usize, JpegError> {
        let (at, unread) = self.bits.marker();
        let unit = at.saturating_sub(self.begin) / self.units.max(1);
        if unread > MOST_UNREAD.min(unit / 2) {
            return Err(JpegError::Damaged(format!(
                "{unread} bytes are left after the last block of a scan"
            )));
        }
        Ok(at)
    }

    fn restart(&mut self, data: &'a [u8], number: u8) -> Result<(), JpegError> {
        let at = self.end()?;
        match data.get(at + 1) {
            Some(marker) if *marker == 0xd0 + number => {}
            Some(0xd0..=0xd7) => {
                return Err(JpegError::Damaged("a restart marker is missing".to_owned()));
            }
            _ => return Err(JpegError::Incomplete),
        }
        self.bits = Bits::new(data, at + 2);
        (self.begin, self.units) = (at + 2, 0);
        self.run = 0;
        self.dc = [0; 4];
        Ok(())
    }

    /// Reads the DC coefficient of a block of component `number`. If data are missing, later coefficients are shifted, and
    /// usually exceed black or white.
    fn dc(&mut self, part: &ScanComponent<'_>, number: usize) -> Result<(), JpegError> {
        let difference = self.bits.difference(part.dc.ok_or_else(missing_table)?)?;
        let dc = self.dc.get_mut(number).ok_or_else(missing_component)?;
        // No overflow: bounded by the check below, and differences by 2^15.
        *dc += difference;
        let levels = i64::from(*dc) << self.low_bits;
        if (levels * i64::from(part.dc_step)).abs() > i64::from(MOST_DC + part.dc_step) {
            return Err(JpegError::Damaged(
                "a block is beyond black or white".to_owned(),
            ));
        }
        Ok(())
    }

    fn sequential(&mut self, part: &ScanComponent<'_>, number: usize) -> Result<(), JpegError> {
        let ac = part.ac.ok_or_else(missing_table)?;
        self.dc(part, number)?;
        let mut place = 1;
        while place < COEFFICIENTS {
            place += usize::from(self.bits.step(ac)?);
        }
        match place {
            COEFFICIENTS => Ok(()),
            _ if place > usize::from(END) => Ok(()),
            _ => Err(too_many_coefficients()),
        }
    }

    /// Whether the block has no coefficients in the band, because of an earlier run.
    fn is_in_run(&mut self) -> bool {
        let is_in_run = self.run > 0;
        self.run = self.run.saturating_sub(1);
        is_in_run
    }

    /// Reads the length of a run of blocks without further coefficients, from this block on.
    fn begin_run(&mut self, bits: u8) -> Result<(), JpegError> {
        // No overflow: below 2^15 + 2^15.
        self.run = (1 << bits) + u32::from(self.bits.value(bits)?);
        Ok(())
    }

    fn first(&mut self, table: &Table, mask: &mut u64) -> Result<(), JpegError> {
        if self.is_in_run() {
            return Ok(());
        }
        let mut place = self.band.0;
        while place <= self.band.1 {
            let symbol = self.bits.symbol(table)?;
            let (zeros, size) = (symbol >> 4, symbol & 15);
            if size == 0 && zeros < 15 {
                self.begin_run(zeros)?;
                self.run -= 1;
                return Ok(());
            }
            place += zeros;
            if size > 0 {
                if place > self.band.1 {
                    return Err(too_many_coefficients());
                }
                self.bits.value(size)?;
                *mask |= 1 << place;
            }
            place += 1;
        }
        Ok(())
    }

    fn refine(&mut self, table: &Table, mask: &mut u64) -> Result<(), JpegError> {
        let mut place = self.band.0;
        if self.run == 0 {
            while place <= self.band.1 {
                let symbol = self.bits.symbol(table)?;
                let (zeros, size) = (symbol >> 4, symbol & 15);
                if size == 0 && zeros < 15 {
                    self.begin_run(zeros)?;
                    break;
                }
                if size > 1 {
                    return Err(JpegError::Damaged("a refined value is invalid".to_owned()));
                }
                // The sign.
                self.bits.value(size)?;
                place = self.skip_zeros(place, zeros, mask)?;
                if size > 0 {
                    if place > self.band.1 {
                        return Err(too_many_coefficients());
                    }
                    *mask |= 1 << place;
                }
                place += 1;
            }
        }
        if self.is_in_run() {
            // A correction bit for each non-zero coefficient.
            for place in place..=self.band.1 {
                if *mask & (1 << place) != 0 {
                    self.bits.value(1)?;
                }
            }
        }
        Ok(())
    }

    /// Skips `zeros` zero coefficients, and the correction bits between them; returns the place of the next zero.
    fn skip_zeros(&mut self, mut place: u8, mut zeros: u8, mask: &u64) -> Result<u8, JpegError> {
        while place <= self.band.1 {
            if *mask & (1 << place) != 0 {
                self.bits.value(1)?;
            } else if zeros == 0 {
                break;
            } else {
                zeros -= 1;
            }
            place += 1;
        }
        Ok(place)
    }
}
