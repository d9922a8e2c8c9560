//! Where an mp4 file keeps its h264 frames. The boxes are parsed by the parser of Firefox.

use mp4parse::{SampleEntry, Track, TrackType, VideoCodecSpecific};

/// The h264 track of a file.
#[derive(Debug)]
pub(super) struct H264Track<'a> {
    /// The decoder's parameters: NAL units that come before the first frame.
    pub parameters: Vec<&'a [u8]>,
    /// Bytes of the length before each NAL unit of a sample, 1 to 4.
    pub length_bytes: usize,
    /// One coded frame each, in decoding order.
    pub samples: Vec<&'a [u8]>,
}

/// Parameters and sample offsets of a file; gives them to `with`, since they borrow from what was parsed.
pub(super) fn with_h264_track<T>(
    bytes: &[u8],
    with: impl FnOnce(H264Track) -> Result<T, String>,
) -> Result<T, String> {
    let mp4 =
        mp4parse::read_mp4(&mut &*bytes).map_err(|error| format!("not an mp4 video: {error}"))?;
    let track = mp4
        .tracks
        .iter()
        .find(|track| track.track_type == TrackType::Video)
        .ok_or_else(|| "it has no video track".to_owned())?;
    let entry = track.stsd.as_ref().and_then(|stsd| {
        stsd.descriptions.iter().find_map(|entry| match entry {
            SampleEntry::Video(video) => Some(video),
            _ => None,
        })
    });
    let entry =
        entry.ok_or_else(|| "expected h264 video, got a codec that is not known".to_owned())?;
    let VideoCodecSpecific::AVCConfig(config) = &entry.codec_specific else {
        return Err(format!(
            "expected h264 video, got codec {:?}",
            entry.codec_type
        ));
    };
    let (length_bytes, parameters) =
        parameters(config).ok_or_else(|| "its h264 parameters (avcC) are cut short".to_owned())?;
    with(H264Track {
        parameters,
        length_bytes,
        samples: samples(track, bytes)?,
    })
}

/// Length size and parameter sets of an `AVCDecoderConfigurationRecord` (ISO/IEC 14496-15, 5.3.3.1).
fn parameters(config: &[u8]) -> Option<(usize, Vec<&[u8]>)> {
    /// Version, profile, compatibility and level come first.
    const FRONT: usize = 4;
    let (&[length_size, sequence_sets], mut rest) = config.get(FRONT..)?.split_first_chunk()?;
    let mut sets = Vec::new();
    // The upper bits are reserved, and set.
    let mut count = sequence_sets & 0b1_1111;
    for _kind in ["sequence", "picture"] {
        for _ in 0..count {
            let (length, after) = rest.split_first_chunk()?;
            let (set, after) = after.split_at_checked(usize::from(u16::from_be_bytes(*length)))?;
            sets.push(set);
            rest = after;
        }
        // The count of picture sets; nothing that is needed follows those.
        count = rest.first().copied().unwrap_or(0);
        rest = rest.get(1..).unwrap_or(&[]);
    }
    Some((usize::from(length_size & 0b11) + 1, sets))
}

/// The bytes of each sample (ISO/IEC 14496-12, 8.7: sizes, samples of each chunk, offsets of the chunks).
fn samples<'a>(track: &Track, bytes: &'a [u8]) -> Result<Vec<&'a [u8]>, String> {
    let (Some(sizes), Some(runs), Some(offsets)) = (&track.stsz, &track.stsc, &track.stco) else {
        return Err("its table of frames is not complete".to_owned());
    };
    if sizes.sample_size != 0 {
        return Err(format!(
            "all of its frames claim {} bytes, which h264 frames do not",
            sizes.sample_size
        ));
    }
    let mut sizes = sizes.sample_sizes.as_slice().iter();
    let mut runs = runs.samples.iter().peekable();
    let mut per_chunk = 0;
    let mut samples = Vec::with_capacity(sizes.len());
    for (number, offset) in (1..).zip(offsets.offsets.iter()) {
        while let Some(run) = runs.next_if(|run| run.first_chunk <= number) {
            per_chunk = run.samples_per_chunk;
        }
        // An offset past the address space is past the file too.
        let mut at = usize::try_from(*offset).unwrap_or(usize::MAX);
        for _ in 0..per_chunk {
            let frame = samples.len();
            let size = *sizes
                .next()
                .ok_or_else(|| format!("it has no size for frame {frame}"))?
                as usize;
            let sample = at.checked_add(size).and_then(|end| bytes.get(at..end));
            samples.push(
                sample.ok_or_else(|| format!("frame {frame}: its bytes are not in the file"))?,
            );
            at += size;
        }
    }
    if sizes.len() > 0 {
        return Err(format!("{} frames have a size and no place", sizes.len()));
    }
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameter_sets_are_found() {
        let config = [
            1, 100, 0, 13, 0xff, 0xe1, 0, 2, 0x67, 7, 1, 0, 3, 0x68, 8, 9, 0xfd,
        ];
        let (length_bytes, sets) = parameters(&config).unwrap();
        assert_eq!(
            (length_bytes, sets),
            (4, vec![&[0x67, 7][..], &[0x68, 8, 9][..]])
        );
        for end in 0..10 {
            assert!(parameters(&config[..end]).is_none(), "cut at {end}");
        }
    }
}
