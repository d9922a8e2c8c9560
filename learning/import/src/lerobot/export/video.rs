use std::{
    fs,
    fs::File,
    io::BufWriter,
    path::{Path, PathBuf},
};

use image::RgbImage;
use mp4::{
    AvcConfig, Bytes, FourCC, MediaConfig, Mp4Config, Mp4Sample, Mp4Writer, TrackConfig, TrackType,
};
use openh264::{
    OpenH264API,
    encoder::{
        BitRate, Encoder, EncoderConfig, FrameRate, IntraFramePeriod, QpRange, RateControlMode,
    },
    formats::{RgbSliceU8, YUVBuffer},
};

use crate::lerobot::LeRobotError;

/// Interval of keyframes: LeRobot's `g`, for seeking.
const GROUP: u32 = 2;
/// Quantisers of H.264, 0 to 51: no visible loss (x264's documentation recommends 17 to 18).
const QUANTISER: (u8, u8) = (10, 18);
/// More than any camera needs: only the quantiser limits the quality, and no frame is dropped.
const BITS_PER_SECOND: u32 = 200_000_000;
/// Ticks of the video's clock per frame, so that all times are whole.
const TICKS_PER_FRAME: u32 = 512;

/// Writes an mp4 file with h264 frames.
pub(super) struct VideoWriter {
    path: PathBuf,
    encoder: Encoder,
    /// Set at the first frame, which has the codec's parameters.
    mp4: Option<Mp4Writer<BufWriter<File>>>,
    file: Option<BufWriter<File>>,
    fps: u32,
    size: (u32, u32),
    frames: u64,
    bytes: u64,
}

impl VideoWriter {
    pub fn create(path: &Path, fps: u32, size: (u32, u32)) -> Result<Self, LeRobotError> {
        if let Some(dir) = path.parent() {
            fs::create_dir_all(dir).map_err(|source| LeRobotError::io(dir, source))?;
        }
        let file = File::create_new(path).map_err(|source| LeRobotError::io(path, source))?;
        let config = EncoderConfig::new()
            .rate_control_mode(RateControlMode::Quality)
            .bitrate(BitRate::from_bps(BITS_PER_SECOND))
            .qp(QpRange::new(QUANTISER.0, QUANTISER.1))
            .max_frame_rate(FrameRate::from_hz(fps as f32))
            .intra_frame_period(IntraFramePeriod::from_num_frames(GROUP))
            .num_threads(1);
        let encoder = Encoder::with_api_config(OpenH264API::from_source(), config)
            .map_err(|error| LeRobotError::corrupt(path, format!("no h264 encoder: {error}")))?;
        Ok(Self {
            path: path.to_owned(),
            encoder,
            mp4: None,
            file: Some(BufWriter::new(file)),
            fps,
            size,
            frames: 0,
            bytes: 0,
        })
    }

    /// Number of frames so far.
    pub const fn frames(&self) -> u64 {
        self.frames
    }

    /// Size of the frames so far \[bytes\].
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Begins an episode: the next frame is a keyframe.
    pub fn begin_episode(&mut self) {
        if self.frames > 0 {
            self.encoder.force_intra_frame();
        }
    }

    /// Adds a frame.
    pub fn write(&mut self, frame: &RgbImage) -> Result<(), LeRobotError> {
        self.try_write(frame)
            .map_err(|reason| LeRobotError::corrupt(&self.path, reason))
    }

    fn try_write(&mut self, frame: &RgbImage) -> Result<(), String> {
        let (width, height) = self.size;
        if frame.dimensions() != self.size {
            return Err(format!(
                "expected a frame of {width} x {height}, got {} x {}",
                frame.width(),
                frame.height()
            ));
        }
        // Fits: sides of an image.
        let source = RgbSliceU8::new(frame.as_raw(), (width as usize, height as usize));
        let encoded = self
            .encoder
            .encode(&YUVBuffer::from_rgb8_source(source))
            .map_err(|error| error.to_string())?
            .to_vec();
        let units: Vec<&[u8]> = openh264::nal_units(&encoded)
            .filter_map(strip_start_code)
            .collect();
        let (parameters, units): (Vec<&[u8]>, Vec<&[u8]>) = units
            .into_iter()
            .partition(|unit| matches!(unit_type(unit), SEQUENCE | PICTURE));
        if units.is_empty() {
            return Err(format!("frame {}: the encoder dropped it", self.frames));
        }
        let mut bytes = Vec::with_capacity(encoded.len());
        for unit in &units {
            let length = u32::try_from(unit.len()).map_err(|error| error.to_string())?;
            bytes.extend(length.to_be_bytes());
            bytes.extend(*unit);
        }
        self.bytes += bytes.len() as u64;
        let sample = Mp4Sample {
            start_time: self.frames * u64::from(TICKS_PER_FRAME),
            duration: TICKS_PER_FRAME,
            rendering_offset: 0,
            is_sync: units.iter().any(|unit| unit_type(unit) == IDR),
            bytes: Bytes::from(bytes),
        };
        let mp4 = match &mut self.mp4 {
            Some(mp4) => mp4,
            none => {
                let file = self.file.take().ok_or("its file is closed")?;
                none.insert(begin_track(file, &parameters, self.fps, self.size)?)
            }
        };
        mp4.write_sample(1, &sample)
            .map_err(|error| error.to_string())?;
        self.frames += 1;
        Ok(())
    }

    /// Closes the file.
    pub fn finish(self) -> Result<(), LeRobotError> {
        let Some(mut mp4) = self.mp4 else {
            return Ok(());
        };
        mp4.write_end()
            .map_err(|error| LeRobotError::corrupt(&self.path, error.to_string()))?;
        let file = mp4.into_writer().into_inner();
        let file = file.map_err(|error| LeRobotError::io(&self.path, error.into_error()))?;
        file.sync_all()
            .map_err(|source| LeRobotError::io(&self.path, source))
    }
}

/// Types of NAL units (H.264, table 7-1).
const IDR: u8 = 5;
const SEQUENCE: u8 = 7;
const PICTURE: u8 = 8;

fn unit_type(unit: &[u8]) -> u8 {
    unit.first().map_or(0, |first| first & 31)
}

/// Removes the start code of a NAL unit.
fn strip_start_code(unit: &[u8]) -> Option<&[u8]> {
    let one = unit.iter().position(|byte| *byte == 1)?;
    unit.get(one + 1..)
}

fn begin_track(
    file: BufWriter<File>,
    parameters: &[&[u8]],
    fps: u32,
    (width, height): (u32, u32),
) -> Result<Mp4Writer<BufWriter<File>>, String> {
    let find = |wanted: u8| {
        let unit = parameters.iter().find(|unit| unit_type(unit) == wanted);
        unit.map(|unit| unit.to_vec()).ok_or_else(|| {
            format!("the encoder returned no parameters (NAL unit of type {wanted})")
        })
    };
    let side = |side: u32| u16::try_from(side).map_err(|error| error.to_string());
    let config = AvcConfig {
        width: side(width)?,
        height: side(height)?,
        seq_param_set: find(SEQUENCE)?,
        pic_param_set: find(PICTURE)?,
    };
    let timescale = fps.checked_mul(TICKS_PER_FRAME).ok_or("fps is too high")?;
    let brands = [*b"isom", *b"iso2", *b"avc1", *b"mp41"].map(|value| FourCC { value });
    let file_config = Mp4Config {
        major_brand: FourCC { value: *b"isom" },
        minor_version: 512,
        compatible_brands: brands.to_vec(),
        timescale,
    };
    let track = TrackConfig {
        track_type: TrackType::Video,
        timescale,
        language: "und".to_owned(),
        media_conf: MediaConfig::AvcConfig(config),
    };
    let mut mp4 = Mp4Writer::write_start(file, &file_config).map_err(|error| error.to_string())?;
    mp4.add_track(&track).map_err(|error| error.to_string())?;
    Ok(mp4)
}
