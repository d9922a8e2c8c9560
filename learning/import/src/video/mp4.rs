//! Places and times of the frames in an mp4 file, parsed by the parser of Firefox.

use std::{ops::Range, path::Path};

use mp4parse::{
    MediaContext, SampleEntry, Track as Mp4Track, TrackType, VideoCodecSpecific,
    unstable::{CheckedInteger, create_sample_table},
};
use wm_camera::video::ColourTags;

use super::colr::colour_tags;

/// The video track of a file.
#[derive(Debug)]
pub(super) struct Track {
    pub codec: Codec,
    /// Colour tags of the file.
    pub colours: ColourTags,
    /// Ticks per second, not 0.
    pub timescale: u64,
    /// In decoding order.
    pub samples: Vec<Sample>,
}

/// The codec of a track's samples.
#[derive(Debug)]
pub(super) enum Codec {
    H264 {
        /// Size of the length before each NAL unit, 1 to 4 \[bytes\].
        length_bytes: usize,
        /// NAL units before the first frame.
        parameters: Vec<Vec<u8>>,
    },
    #[cfg(feature = "av1")]
    Av1,
}

#[derive(Debug)]
pub(super) struct Sample {
    /// Its bytes, within the file.
    pub bytes: Range<usize>,
    /// Presentation time, in ticks since the start.
    pub time: i64,
    /// Whether it is a keyframe.
    pub is_sync: bool,
}

pub(super) fn read(bytes: &[u8], file: &Path) -> Result<Track, String> {
    let mp4 =
        mp4parse::read_mp4(&mut &*bytes).map_err(|error| format!("not an mp4 video: {error}"))?;
    let track = mp4
        .tracks
        .iter()
        .find(|track| track.track_type == TrackType::Video)
        .ok_or_else(|| "it has no video track".to_owned())?;
    let timescale = track.timescale.map(|scale| scale.0);
    Ok(Track {
        codec: detect_codec(track, file)?,
        colours: colour_tags(bytes),
        timescale: timescale
            .filter(|scale| *scale > 0)
            .ok_or("its video track has no timescale")?,
        samples: samples(&mp4, track, bytes.len())?,
    })
}

fn detect_codec(track: &Mp4Track, file: &Path) -> Result<Codec, String> {
    let entry = track.stsd.as_ref().and_then(|stsd| {
        stsd.descriptions.iter().find_map(|entry| match entry {
            SampleEntry::Video(video) => Some(video),
            _ => None,
        })
    });
    match entry.map(|entry| &entry.codec_specific) {
        Some(VideoCodecSpecific::AVCConfig(config)) => {
            let (length_bytes, parameters) = parse_parameters(config)
                .ok_or_else(|| "its h264 parse_parameters (avcC) are truncated".to_owned())?;
            Ok(Codec::H264 {
                length_bytes,
                parameters,
            })
        }
        #[cfg(feature = "av1")]
        Some(VideoCodecSpecific::AV1Config(config)) => {
            let chroma = (config.chroma_subsampling_x, config.chroma_subsampling_y);
            match (config.bit_depth, config.monochrome, chroma) {
                (8, false, (1, 1)) => Ok(Codec::Av1),
                (bits, ..) => Err(format!(
                    "expected 8-bit AV1 with 4:2:0 chroma (yuv420p), got {bits} bits and chroma subsampling of {chroma:?}"
                )),
            }
        }
        _ => {
            let expected = if cfg!(feature = "av1") {
                "h264 or AV1"
            } else {
                "h264"
            };
            let codec = entry.map_or("an unknown codec".to_owned(), |entry| {
                format!("{:?}", entry.codec_type)
            });
            Err(format!(
                "expected video in {expected}, got {codec}; convert it with: ffmpeg -i {} -c:v libx264 -pix_fmt \
                 yuv420p -fps_mode passthrough OUT.mp4",
                file.display()
            ))
        }
    }
}

/// Length size and parameter sets of an `AVCDecoderConfigurationRecord` (ISO/IEC 14496-15, 5.3.3.1).
fn parse_parameters(config: &[u8]) -> Option<(usize, Vec<Vec<u8>>)> {
    /// Size of version, profile, compatibility and level.
    const FRONT: usize = 4;
    let (&[length_size, sequence_sets], mut rest) = config.get(FRONT..)?.split_first_chunk()?;
    let mut sets = Vec::new();
    // The upper bits are reserved.
    let mut count = sequence_sets & 0b1_1111;
    for _kind in ["sequence", "picture"] {
        for _ in 0..count {
            let (length, after) = rest.split_first_chunk()?;
            let (set, after) = after.split_at_checked(usize::from(u16::from_be_bytes(*length)))?;
            sets.push(set.to_vec());
            rest = after;
        }
        // The count of picture parameter sets; a truncated one counts as 0.
        count = rest.first().copied().unwrap_or(0);
        rest = rest.get(1..).unwrap_or(&[]);
    }
    Some((usize::from(length_size & 0b11) + 1, sets))
}

/// Place and time of each sample (ISO/IEC 14496-12, 8.6 and 8.7), after the first edit of the edit list.
fn samples(mp4: &MediaContext, track: &Mp4Track, file_bytes: usize) -> Result<Vec<Sample>, String> {
    // Checked against the file first: the library makes a table as long as the boxes claim.
    let claimed = count_samples(track, file_bytes)?;
    let table = create_sample_table(track, CheckedInteger(0))
        .ok_or_else(|| "its frame table is incomplete".to_owned())?;
    if table.len() != claimed {
        return Err(format!(
            "expected the {claimed} frames that have a size, {} have a place",
            table.len()
        ));
    }
    let start = start(mp4, track).ok_or("its edit list is invalid")?;
    table
        .iter()
        .enumerate()
        .map(|(frame, sample)| {
            let (from, to) = (sample.start_offset.0, sample.end_offset.0);
            let bytes = usize::try_from(from).ok().zip(usize::try_from(to).ok());
            let (from, to) = bytes
                .filter(|(from, to)| from <= to && *to <= file_bytes)
                .ok_or_else(|| format!("frame {frame}: its data is not in the file"))?;
            let time = sample.start_composition.0.checked_add(start);
            Ok(Sample {
                bytes: from..to,
                time: time.ok_or_else(|| format!("frame {frame}: its time is invalid"))?,
                is_sync: sample.sync,
            })
        })
        .collect()
}

/// Number of frames, if the boxes of sizes and chunks agree and the file can have them.
fn count_samples(track: &Mp4Track, file_bytes: usize) -> Result<usize, String> {
    let (Some(sizes), Some(runs), Some(offsets), Some(_)) =
        (&track.stsz, &track.stsc, &track.stco, &track.stts)
    else {
        return Err("its frame table is incomplete".to_owned());
    };
    if sizes.sample_size != 0 {
        return Err(format!(
            "all of its frames claim {} bytes, which coded frames do not",
            sizes.sample_size
        ));
    }
    let claimed = sizes.sample_sizes.len();
    let mut runs_left = runs.samples.iter().peekable();
    let (mut per_chunk, mut in_chunks) = (0u64, 0u64);
    for number in (1u32..).take(offsets.offsets.len()) {
        while let Some(run) = runs_left.next_if(|run| run.first_chunk <= number) {
            per_chunk = u64::from(run.samples_per_chunk);
        }
        in_chunks = in_chunks.saturating_add(per_chunk);
    }
    if in_chunks != claimed as u64 || claimed > file_bytes {
        return Err(format!(
            "{claimed} frames have a size, {in_chunks} have a place, in {file_bytes} bytes"
        ));
    }
    Ok(claimed)
}

/// Offset from composition time to presentation time, in ticks.
fn start(mp4: &MediaContext, track: &Mp4Track) -> Option<i64> {
    let skipped = track.media_time.map_or(0, |time| time.0);
    let delay = match (track.empty_duration, mp4.timescale, track.timescale) {
        (Some(delay), Some(movie), Some(own)) if movie.0 > 0 => {
            delay.0.checked_mul(own.0)? / movie.0
        }
        _ => 0,
    };
    i64::try_from(delay)
        .ok()?
        .checked_sub(i64::try_from(skipped).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameter_sets_are_found() {
        let config = [
            1, 100, 0, 13, 0xff, 0xe1, 0, 2, 0x67, 7, 1, 0, 3, 0x68, 8, 9, 0xfd,
        ];
        let (length_bytes, sets) = parse_parameters(&config).unwrap();
        assert_eq!(
            (length_bytes, sets),
            (4, vec![vec![0x67, 7], vec![0x68, 8, 9]])
        );
        for end in 0..10 {
            assert!(parse_parameters(&config[..end]).is_none(), "cut at {end}");
        }
    }
}
