//! The frame header of a JPEG: size and layout of its components (ITU-T T.81, B.2.2).

use super::JpegError;
use crate::limits::MAX_SIDE;

/// Colour space of the components.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Colours {
    Grey,
    YCbCr,
    Rgb,
}

/// A component: a plane of samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Component {
    pub id: u8,
    /// Horizontal and vertical sampling factors, 1 to 4.
    pub factors: (u8, u8),
    /// Id of the quantisation table.
    pub quantisation: u8,
}

#[derive(Clone, Debug)]
pub(super) struct Frame {
    pub width: u32,
    pub height: u32,
    pub is_progressive: bool,
    /// One or three.
    pub components: Vec<Component>,
}

impl Frame {
    /// Reads the segment of the marker `0xff, kind`.
    ///
    /// # Errors
    /// [`JpegError::Layout`], [`JpegError::Size`], or a damaged segment.
    pub(super) fn read(kind: u8, segment: &[u8]) -> Result<Self, JpegError> {
        let is_progressive = match kind {
            0xc0 | 0xc1 => false,
            0xc2 => true,
            0xc3 => return Err(JpegError::Layout("lossless coding")),
            0xc9..=0xcb | 0xcd..=0xcf => return Err(JpegError::Layout("arithmetic coding")),
            _ => return Err(JpegError::Layout("hierarchical coding")),
        };
        let damaged = || JpegError::Damaged("its frame header is invalid".to_owned());
        let (&[precision, h1, h0, w1, w0, number], rest) =
            segment.split_first_chunk().ok_or_else(damaged)?;
        if precision != 8 {
            return Err(JpegError::Layout("other than 8 bits a sample"));
        }
        let (height, width) = (
            u32::from(u16::from_be_bytes([h1, h0])),
            u32::from(u16::from_be_bytes([w1, w0])),
        );
        if height == 0 && width > 0 {
            return Err(JpegError::Layout("its height after the first scan (DNL)"));
        }
        if width == 0 || width > MAX_SIDE || height > MAX_SIDE {
            return Err(JpegError::Size { width, height });
        }
        match number {
            1 | 3 => {}
            4 => return Err(JpegError::Layout("four components (CMYK or YCCK)")),
            _ => return Err(JpegError::Layout("other than one or three components")),
        }
        if rest.len() != usize::from(number) * 3 {
            return Err(damaged());
        }
        let mut components: Vec<Component> = Vec::new();
        for bytes in rest.as_chunks::<3>().0 {
            let [id, factors, quantisation] = *bytes;
            let factors = (factors >> 4, factors & 15);
            let fits = |factor: u8| (1..=4).contains(&factor);
            let is_new = components.iter().all(|other| other.id != id);
            if !fits(factors.0) || !fits(factors.1) || quantisation > 3 || !is_new {
                return Err(damaged());
            }
            components.push(Component {
                id,
                factors,
                quantisation,
            });
        }
        if let [only] = components.as_mut_slice() {
            // Factors are relative: a single component has 1.
            only.factors = (1, 1);
        }
        Ok(Self {
            width,
            height,
            is_progressive,
            components,
        })
    }

    pub(super) fn most_factors(&self) -> (u32, u32) {
        let most = |of: fn(&Component) -> u8| {
            let factors = self.components.iter().map(of);
            // A frame has at least one component.
            u32::from(factors.max().unwrap_or(1))
        };
        (most(|c| c.factors.0), most(|c| c.factors.1))
    }

    /// Number of 8 x 8 blocks of a component, across and down.
    pub(super) fn blocks(&self, component: &Component) -> (u32, u32) {
        let (most_across, most_down) = self.most_factors();
        let blocks = |side: u32, factor: u8, most: u32| {
            (side * u32::from(factor)).div_ceil(most).div_ceil(8)
        };
        (
            blocks(self.width, component.factors.0, most_across),
            blocks(self.height, component.factors.1, most_down),
        )
    }

    /// Number of units in an interleaved scan, across and down; each has as many blocks of a component as its factors.
    pub(super) fn units(&self) -> (u32, u32) {
        let (across, down) = self.most_factors();
        (
            self.width.div_ceil(8 * across),
            self.height.div_ceil(8 * down),
        )
    }

    /// The colour space, by the rules of libjpeg: JFIF's marker, then Adobe's, then the component ids.
    pub(super) fn colours(&self, is_jfif: bool, adobe: Option<u8>) -> Colours {
        let ids: Vec<u8> = self.components.iter().map(|c| c.id).collect();
        match (is_jfif, adobe) {
            _ if ids.len() == 1 => Colours::Grey,
            (false, Some(0)) => Colours::Rgb,
            (false, None) if ids == *b"RGB" => Colours::Rgb,
            _ => Colours::YCbCr,
        }
    }
}
