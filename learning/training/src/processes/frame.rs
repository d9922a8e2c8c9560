//! Frames on a connection: a kind, a length and a body.
//!
//! A body is a [`Message`] in JSON, or a header with numbers of the network as little-endian `f32`. The receiver knows
//! the length of the latter, so that it never reserves memory for a length that the sender claims.

use std::{
    fmt,
    io::{self, Read, Write},
    ops::Range,
};

use thiserror::Error;

use super::message::Message;
use crate::{
    gradient_tree::{Node, Place},
    run::StepLoss,
};

/// First bytes in each direction; the last one is the version of the format.
pub const MAGIC: [u8; 8] = *b"wmtrain\x01";
/// Most bytes of a message. The greatest are descriptions of data with hundreds of joints.
pub const LONGEST_MESSAGE: u64 = 256 << 10;
/// Step, first batch, end.
const PART_BYTES: u64 = 24;
/// Time of a computation.
const SECONDS_BYTES: u64 = 8;
/// Values converted at once.
const CHUNK: usize = 16 << 10;

/// A frame that cannot be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FrameError {
    /// The connection ended, or took too long.
    #[error("{}", explained(.0))]
    Io(#[from] io::Error),
    /// Another protocol.
    #[error("expected a process of `wm train` with the same format, received {:?}", .0.escape_ascii().to_string())]
    Foreign([u8; 8]),
    /// An unknown kind.
    #[error("expected a kind of frame from 1 to 3, received {0}")]
    Kind(u8),
    /// A frame of another kind.
    #[error("expected {expected}, received {found:?}")]
    Unexpected {
        /// Expected kinds.
        expected: &'static str,
        /// Received kind.
        found: Kind,
    },
    /// A message that is too long.
    #[error("expected a message of at most {LONGEST_MESSAGE} bytes, received {0}")]
    TooLong(u64),
    /// Another amount of numbers.
    #[error("expected a frame of {expected} bytes, received {found}: the networks differ")]
    Length {
        /// Expected bytes.
        expected: u64,
        /// Received bytes.
        found: u64,
    },
    /// Sums of other batches.
    #[error("expected {expected}, received {found}")]
    Part {
        /// Expected batches.
        expected: Part,
        /// Received batches.
        found: Part,
    },
    /// A message that is not JSON.
    #[error("unreadable message: {0}")]
    Malformed(#[from] serde_json::Error),
}

fn explained(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => "it closed the connection".to_owned(),
        io::ErrorKind::TimedOut => "it did not answer in time".to_owned(),
        _ => error.to_string(),
    }
}

/// Kind of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A [`Message`].
    Message,
    /// Weights, and the batches to compute.
    Job,
    /// Sums of computed batches.
    Sums,
}

/// Header of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Kind.
    pub kind: Kind,
    /// Bytes of the body.
    pub length: u64,
}

/// Batches of a step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Index of the step.
    pub step: u64,
    /// Batches.
    pub batches: Range<usize>,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { step, batches } = self;
        write!(f, "batches {batches:?} of step {step}")
    }
}

/// Sends the first bytes of a direction.
///
/// # Errors
/// If the connection fails.
pub fn write_magic(to: &mut impl Write) -> Result<(), FrameError> {
    Ok(to.write_all(&MAGIC)?)
}

/// Checks the first bytes of a direction.
///
/// # Errors
/// If they differ, or the connection fails.
pub fn read_magic(from: &mut impl Read) -> Result<(), FrameError> {
    let found = read_array(from)?;
    match found == MAGIC {
        true => Ok(()),
        false => Err(FrameError::Foreign(found)),
    }
}

fn write_header(to: &mut impl Write, kind: Kind, length: u64) -> io::Result<()> {
    let kind: u8 = match kind {
        Kind::Message => 1,
        Kind::Job => 2,
        Kind::Sums => 3,
    };
    let mut bytes = [kind; 9];
    if let Some(place) = bytes.get_mut(1..) {
        place.copy_from_slice(&length.to_le_bytes());
    }
    to.write_all(&bytes)
}

/// Reads a header.
///
/// # Errors
/// If the kind is unknown, or the connection fails.
pub fn read_header(from: &mut impl Read) -> Result<Header, FrameError> {
    let [kind] = read_array(from)?;
    let kind = match kind {
        1 => Kind::Message,
        2 => Kind::Job,
        3 => Kind::Sums,
        other => return Err(FrameError::Kind(other)),
    };
    let length = u64::from_le_bytes(read_array(from)?);
    Ok(Header { kind, length })
}

/// Sends a message.
///
/// # Errors
/// If it is too long, or the connection fails.
pub fn write_message(to: &mut impl Write, message: &Message) -> Result<(), FrameError> {
    let body = serde_json::to_vec(message)?;
    let length = body.len() as u64;
    if length > LONGEST_MESSAGE {
        return Err(FrameError::TooLong(length));
    }
    write_header(to, Kind::Message, length)?;
    Ok(to.write_all(&body)?)
}

/// Reads a message with its header.
///
/// # Errors
/// If it is another frame, too long or unreadable, or the connection fails.
pub fn read_message(from: &mut impl Read) -> Result<Message, FrameError> {
    let header = read_header(from)?;
    read_message_body(from, header)
}

/// Reads a message after its header.
///
/// # Errors
/// Those of [`read_message`].
pub fn read_message_body(from: &mut impl Read, header: Header) -> Result<Message, FrameError> {
    expect_kind(header, Kind::Message, "a message")?;
    if header.length > LONGEST_MESSAGE {
        return Err(FrameError::TooLong(header.length));
    }
    // Memory grows with the received bytes.
    let mut body = Vec::new();
    from.take(header.length).read_to_end(&mut body)?;
    if (body.len() as u64) < header.length {
        return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
    }
    Ok(serde_json::from_slice(&body)?)
}

/// Sends `weights` and the batches to compute with them.
///
/// # Errors
/// If the connection fails.
pub fn write_job(to: &mut impl Write, part: &Part, weights: &[Vec<f32>]) -> Result<(), FrameError> {
    let sizes = weights.iter().map(Vec::len);
    write_header(to, Kind::Job, PART_BYTES + bytes_of(sizes))?;
    write_part(to, part)?;
    Ok(write_values(to, weights)?)
}

/// Reads a job after its header; `sizes` are the numbers of values per parameter.
///
/// # Errors
/// If it is another frame or of another length, or the connection fails.
pub fn read_job(
    from: &mut impl Read,
    header: Header,
    sizes: &[usize],
) -> Result<(Part, Vec<Vec<f32>>), FrameError> {
    expect_kind(header, Kind::Job, "a job")?;
    expect_length(header, PART_BYTES + bytes_of(sizes.iter().copied()))?;
    Ok((read_part(from)?, read_values(from, sizes)?))
}

/// Sends the sums of a part, computed in `seconds`. Each node has one loss and the gradient of all parameters.
///
/// # Errors
/// If the connection fails.
pub fn write_sums(
    to: &mut impl Write,
    part: &Part,
    (seconds, nodes): (f64, &[Node]),
) -> Result<(), FrameError> {
    let sizes = |node: &Node| {
        let gradient = node.sum.gradient.iter();
        size_of::<f32>() as u64 + bytes_of(gradient.map(Vec::len))
    };
    let length = PART_BYTES + SECONDS_BYTES + nodes.iter().map(sizes).sum::<u64>();
    write_header(to, Kind::Sums, length)?;
    write_part(to, part)?;
    to.write_all(&seconds.to_le_bytes())?;
    for node in nodes {
        to.write_all(&node.sum.loss.to_le_bytes())?;
        write_values(to, &node.sum.gradient)?;
    }
    Ok(())
}

/// Reads the sums of `part` after their header: nodes at `places`, with `sizes` values per parameter. Returns the time of
/// the computation, too.
///
/// # Errors
/// If it is another frame, of another length or part, or the connection fails.
pub fn read_sums(
    from: &mut impl Read,
    header: Header,
    part: &Part,
    (places, sizes): (&[Place], &[usize]),
) -> Result<(f64, Vec<Node>), FrameError> {
    expect_kind(header, Kind::Sums, "sums")?;
    let of_node = size_of::<f32>() as u64 + bytes_of(sizes.iter().copied());
    let of_nodes = places.len() as u64 * of_node;
    expect_length(header, PART_BYTES + SECONDS_BYTES + of_nodes)?;
    let found = read_part(from)?;
    if found != *part {
        let expected = part.clone();
        return Err(FrameError::Part { expected, found });
    }
    let seconds = f64::from_le_bytes(read_array(from)?);
    let nodes = places.iter().map(|place| {
        Ok::<_, FrameError>(Node {
            place: *place,
            sum: StepLoss {
                loss: f32::from_le_bytes(read_array(from)?),
                parts: Vec::new(),
                gradient: read_values(from, sizes)?,
            },
        })
    });
    Ok((seconds, nodes.collect::<Result<_, _>>()?))
}

fn expect_kind(header: Header, kind: Kind, expected: &'static str) -> Result<(), FrameError> {
    let found = header.kind;
    match found == kind {
        true => Ok(()),
        false => Err(FrameError::Unexpected { expected, found }),
    }
}

fn expect_length(header: Header, expected: u64) -> Result<(), FrameError> {
    let found = header.length;
    match found == expected {
        true => Ok(()),
        false => Err(FrameError::Length { expected, found }),
    }
}

fn bytes_of(sizes: impl Iterator<Item = usize>) -> u64 {
    sizes.sum::<usize>() as u64 * size_of::<f32>() as u64
}

fn write_part(to: &mut impl Write, part: &Part) -> io::Result<()> {
    let ends = [part.batches.start, part.batches.end].map(|end| end as u64);
    to.write_all(&part.step.to_le_bytes())?;
    ends.iter()
        .try_for_each(|end| to.write_all(&end.to_le_bytes()))
}

fn read_part(from: &mut impl Read) -> io::Result<Part> {
    let step = u64::from_le_bytes(read_array(from)?);
    let mut end = || {
        let end = u64::from_le_bytes(read_array(from)?);
        usize::try_from(end).map_err(|_| io::Error::from(io::ErrorKind::InvalidData))
    };
    let batches = end()?..end()?;
    Ok(Part { step, batches })
}

fn write_values(to: &mut impl Write, values: &[Vec<f32>]) -> io::Result<()> {
    let mut bytes = Vec::with_capacity(CHUNK * size_of::<f32>());
    for chunk in values.iter().flat_map(|values| values.chunks(CHUNK)) {
        bytes.clear();
        bytes.extend(chunk.iter().flat_map(|value| value.to_le_bytes()));
        to.write_all(&bytes)?;
    }
    Ok(())
}

fn read_values(from: &mut impl Read, sizes: &[usize]) -> io::Result<Vec<Vec<f32>>> {
    let mut bytes = vec![0; CHUNK * size_of::<f32>()];
    let all = sizes.iter().map(|&size| {
        let mut values = Vec::with_capacity(size);
        while values.len() < size {
            let count = (size - values.len()).min(CHUNK);
            let chunk = bytes.get_mut(..count * size_of::<f32>());
            let chunk = chunk.ok_or(io::ErrorKind::InvalidInput)?;
            from.read_exact(chunk)?;
            let (chunk, _) = chunk.as_chunks::<4>();
            values.extend(chunk.iter().map(|bytes| f32::from_le_bytes(*bytes)));
        }
        Ok(values)
    });
    all.collect()
}

fn read_array<const N: usize>(from: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    from.read_exact(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests;
