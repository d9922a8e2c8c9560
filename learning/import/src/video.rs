//! Frames of an mp4 video and their presentation times.
//!
//! Decodes h264, and AV1 with the feature `av1`. As in ffmpeg, colours follow the tags of the stream, then of the file; the
//! default is BT.601 in the limited range. Not supported: sound, fragmented files, more than 8 bits per channel, chroma
//! other than 4:2:0.

#[cfg(feature = "av1")]
mod av1;
mod colr;
mod h264;
mod mp4;

use std::{
    fs,
    ops::Range,
    path::{Path, PathBuf},
};

use image::RgbImage;
use wm_camera::video::ColourTags;

use crate::{ImportError, jpeg::encode_jpeg};
use mp4::{Codec, Sample};

/// Limit of a file, which is read at once; LeRobot starts a new one at 200 MB (500 MB in early versions of v3.0).
const MAX_BYTES: u64 = 2 << 30;

/// An open video: its frames are indexed, not yet decoded.
#[derive(Debug)]
pub struct Video {
    file: PathBuf,
    bytes: Vec<u8>,
    codec: Codec,
    colours: ColourTags,
    /// Ticks per second.
    timescale: u64,
    /// Encoded frames, in decoding order.
    samples: Vec<Sample>,
    /// Indices of the presented samples, in presentation order.
    shown: Vec<usize>,
}

/// Decodes samples in decoding order; returns frames in presentation order.
trait Decoder {
    /// Decodes a sample; returns the frames that are ready.
    fn feed(&mut self, sample: &[u8]) -> Result<Vec<RgbImage>, String>;
    /// Returns the remaining frames.
    fn finish(&mut self) -> Result<Vec<RgbImage>, String>;
}

impl Video {
    /// Opens an mp4 file and finds its frames.
    ///
    /// # Errors
    /// The file cannot be read, is not a complete mp4 video, or its codec is not supported (with the command that converts
    /// it).
    pub fn open(file: &Path) -> Result<Self, ImportError> {
        let found = fs::metadata(file).map_err(|source| ImportError::io(file, source))?;
        if found.len() > MAX_BYTES {
            return Err(ImportError::corrupt(
                file,
                format!(
                    "expected a video of at most {MAX_BYTES} bytes, got {}",
                    found.len()
                ),
            ));
        }
        let bytes = fs::read(file).map_err(|source| ImportError::io(file, source))?;
        let track = mp4::read(&bytes, file).map_err(|reason| ImportError::corrupt(file, reason))?;
        let mut shown: Vec<usize> = (0..track.samples.len()).collect();
        // Samples before the edit list's start are decoded and not presented.
        shown.retain(|number| time(&track.samples, *number) >= 0);
        shown.sort_by_key(|number| time(&track.samples, *number));
        Ok(Self {
            file: file.to_owned(),
            bytes,
            codec: track.codec,
            colours: track.colours,
            timescale: track.timescale,
            samples: track.samples,
            shown,
        })
    }

    /// The path.
    #[must_use]
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Number of presented frames.
    #[must_use]
    pub fn frame_count(&self) -> usize {
        self.shown.len()
    }

    /// Presentation time of a frame, in s since the video's start; `None` past the last.
    #[must_use]
    pub fn time_s(&self, frame: usize) -> Option<f64> {
        let number = self.shown.get(frame)?;
        // Exact: ticks of any video fit 53 bits.
        Some(time(&self.samples, *number) as f64 / self.timescale as f64)
    }

    /// The frame with the nearest time, and its time in s; `None` without frames.
    #[must_use]
    pub fn nearest(&self, time_s: f64) -> Option<(usize, f64)> {
        let after = self.shown.partition_point(|number| {
            (time(&self.samples, *number) as f64) < time_s * self.timescale as f64
        });
        [after.checked_sub(1), Some(after)]
            .into_iter()
            .flatten()
            .filter_map(|frame| Some((frame, self.time_s(frame)?)))
            .min_by(|(_, a), (_, b)| (a - time_s).abs().total_cmp(&(b - time_s).abs()))
    }

    /// Decodes a range of frames and passes each to `each`, in order.
    ///
    /// # Errors
    /// The range is past the end; a frame cannot be decoded; frames are missing in the stream; or `each` fails.
    pub fn decode(
        &self,
        frames: Range<usize>,
        mut each: impl FnMut(RgbImage) -> Result<(), String>,
    ) -> Result<(), ImportError> {
        self.try_decode(frames, &mut each)
            .map_err(|reason| ImportError::corrupt(&self.file, reason))
    }

    fn try_decode(
        &self,
        frames: Range<usize>,
        each: &mut dyn FnMut(RgbImage) -> Result<(), String>,
    ) -> Result<(), String> {
        let wanted = self.shown.get(frames.clone()).ok_or_else(|| {
            format!(
                "expected frames {} to {}, it has {}",
                frames.start,
                frames.end,
                self.shown.len()
            )
        })?;
        let (Some(first), Some(last)) = (wanted.iter().min(), wanted.iter().max()) else {
            return Ok(());
        };
        // Decoding starts at a keyframe, at or before the first wanted frame.
        let begin = (0..=*first)
            .rev()
            .find(|number| {
                self.samples.get(*number).is_some_and(|sample| {
                    sample.is_sync
                        && wanted
                            .iter()
                            .all(|w| time(&self.samples, *w) >= sample.time)
                })
            })
            .unwrap_or(0);
        let fed = begin..last + 1;
        // In presentation order.
        let mut times: Vec<i64> = fed.clone().map(|n| time(&self.samples, n)).collect();
        times.sort_unstable();
        let wanted_times: Vec<i64> = wanted.iter().map(|n| time(&self.samples, *n)).collect();
        let mut decoder = self.decoder()?;
        let (mut given, mut handed) = (0, 0);
        let mut take = |ready: Vec<RgbImage>| {
            for frame in ready {
                let shown_at = times.get(given);
                given += 1;
                if shown_at.is_some() && shown_at == wanted_times.get(handed) {
                    handed += 1;
                    each(frame)?;
                }
            }
            Ok::<(), String>(())
        };
        for number in fed.clone() {
            let sample = self.samples.get(number).ok_or("no such sample")?;
            let bytes = self.bytes.get(sample.bytes.clone());
            let bytes =
                bytes.ok_or_else(|| format!("frame {number}: its data is not in the file"))?;
            let ready = decoder.feed(bytes);
            take(ready.map_err(|reason| format!("frame {number}: {reason}"))?)?;
        }
        take(decoder.finish()?)?;
        if given != fed.len() || handed != wanted.len() {
            return Err(format!("expected {} frames, decoded {given}", fed.len()));
        }
        Ok(())
    }

    /// Decodes frames and encodes them as JPEG of this quality, 1 to 100.
    pub fn jpegs(&self, frames: Range<usize>, quality: u8) -> Result<Vec<Vec<u8>>, ImportError> {
        let mut jpegs = Vec::with_capacity(frames.len());
        self.decode(frames, |frame| {
            jpegs.push(encode_jpeg(&frame, quality).map_err(|error| error.to_string())?);
            Ok(())
        })?;
        Ok(jpegs)
    }

    fn decoder(&self) -> Result<Box<dyn Decoder>, String> {
        match &self.codec {
            Codec::H264 {
                length_bytes,
                parameters,
            } => {
                let decoder = h264::H264Decoder::new(*length_bytes, parameters, self.colours);
                Ok(Box::new(decoder?))
            }
            #[cfg(feature = "av1")]
            Codec::Av1 => Ok(Box::new(av1::Av1Decoder::new(self.colours)?)),
        }
    }
}

/// Presentation time of a sample, in ticks; missing samples come last.
fn time(samples: &[Sample], number: usize) -> i64 {
    samples.get(number).map_or(i64::MAX, |sample| sample.time)
}

#[cfg(test)]
mod tests;
