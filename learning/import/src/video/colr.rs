//! Colour tags of an mp4 file (ISO/IEC 14496-12, 12.1.5), which the parser of other boxes skips.

use wm_camera::video::ColourTags;

/// Path of boxes to the video's sample entries.
const PATH: [&[u8; 4]; 6] = [b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd"];
/// Sample entries of the supported codecs.
const ENTRIES: [&[u8; 4]; 3] = [b"avc1", b"avc3", b"av01"];
/// Size of version, flags and number of entries, before the sample entries.
const ENTRIES_BEGIN: usize = 8;
/// Size of a video's sample entry before its boxes.
const BOXES_BEGIN: usize = 78;

/// The tags of the first video; empty without a `colr` box.
pub(super) fn colour_tags(file: &[u8]) -> ColourTags {
    find(file, &PATH).unwrap_or_default()
}

fn find(boxes: &[u8], path: &[&[u8; 4]]) -> Option<ColourTags> {
    let Some((next, path)) = path.split_first() else {
        let entries = Boxes(boxes.get(ENTRIES_BEGIN..)?);
        let mut videos = entries.filter(|(name, _)| ENTRIES.contains(name));
        let (_, entry) = videos.next()?;
        let (_, colr) = Boxes(entry.get(BOXES_BEGIN..)?).find(|(name, _)| *name == b"colr")?;
        return tags(colr);
    };
    Boxes(boxes)
        .filter(|(name, _)| name == next)
        .find_map(|(_, content)| find(content, path))
}

fn tags(colr: &[u8]) -> Option<ColourTags> {
    let (kind, rest) = colr.split_first_chunk::<4>()?;
    // After primaries and transfer.
    let matrix = u16::from_be_bytes(*rest.get(4..)?.first_chunk()?);
    let is_full_range = match kind {
        b"nclx" => Some(rest.get(6)? & 0x80 != 0),
        b"nclc" => None,
        _ => return None,
    };
    Some(ColourTags {
        matrix: u8::try_from(matrix).ok(),
        is_full_range,
    })
}

/// Iterates over names and contents of boxes; ends at a damaged one.
struct Boxes<'a>(&'a [u8]);

impl<'a> Iterator for Boxes<'a> {
    type Item = (&'a [u8; 4], &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let (length, rest) = self.0.split_first_chunk::<4>()?;
        let (name, rest) = rest.split_first_chunk::<4>()?;
        let (content, header) = match u32::from_be_bytes(*length) {
            // Up to the end of its parent.
            0 => (rest.len(), 0),
            1 => {
                let (length, _) = rest.split_first_chunk()?;
                let length = usize::try_from(u64::from_be_bytes(*length)).ok()?;
                (length.checked_sub(16)?, 8)
            }
            length => (usize::try_from(length).ok()?.checked_sub(8)?, 0),
        };
        let rest = rest.get(header..)?;
        let (content, rest) = rest.split_at_checked(content)?;
        self.0 = rest;
        Some((name, content))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn in_box(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
        let length = u32::try_from(content.len() + 8).unwrap();
        [length.to_be_bytes().as_slice(), name, content].concat()
    }

    fn file(entry: &[u8; 4], colr: &[u8]) -> Vec<u8> {
        let boxes = [in_box(b"avcC", &[1, 2, 3]), in_box(b"colr", colr)].concat();
        let entry = in_box(entry, &[&[0; BOXES_BEGIN], boxes.as_slice()].concat());
        let stsd = in_box(b"stsd", &[&[0; ENTRIES_BEGIN], entry.as_slice()].concat());
        let names = PATH.iter().rev().skip(1);
        let moov = names.fold(stsd, |content, name| in_box(name, &content));
        [in_box(b"ftyp", b"isom"), moov].concat()
    }

    #[test]
    fn colour_tags_of_a_file_are_found() {
        let tags = |matrix, is_full_range| ColourTags {
            matrix: Some(matrix),
            is_full_range,
        };
        for (colr, expected) in [
            (&b"nclx\0\x01\0\x01\0\x01\x80"[..], tags(1, Some(true))),
            (b"nclx\0\x01\0\x01\0\x06\0", tags(6, Some(false))),
            (b"nclc\0\x01\0\x01\0\x09", tags(9, None)),
            (b"prof1234567890", ColourTags::default()),
            (b"nclx", ColourTags::default()),
        ] {
            assert_eq!(colour_tags(&file(b"avc1", colr)), expected, "{colr:?}");
            assert_eq!(colour_tags(&file(b"mp4a", colr)), ColourTags::default());
        }
        let whole = file(b"av01", b"nclx\0\x01\0\x01\0\x01\x80");
        for length in 0..whole.len() {
            assert_eq!(
                colour_tags(&whole[..length]),
                ColourTags::default(),
                "cut at {length}"
            );
        }
    }
}
