//! Encodings of messages.

use crate::schema::canonical_type_name;

/// Protobuf types that the reader accepts: pictures as Foxglove's tools record them. `wm_camera` decodes them.
pub(crate) const PROTOBUF_TYPES: [&str; 3] = [
    "foxglove.CompressedImage",
    "foxglove.CompressedVideo",
    "foxglove.RawImage",
];

/// An encoding of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageEncoding {
    /// CDR, the encoding of ROS 2.
    Cdr,
    /// Protocol buffers, only of Foxglove's picture types.
    Protobuf,
}

impl MessageEncoding {
    /// The name in MCAP and rosbag2 files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cdr => "cdr",
            Self::Protobuf => "protobuf",
        }
    }

    /// Encoding and canonical type name of a channel.
    ///
    /// # Errors
    /// The reason why its messages cannot be read.
    pub(crate) fn of_channel(
        encoding: &str,
        type_name: Option<&str>,
    ) -> Result<(Self, String), String> {
        let found = [Self::Cdr, Self::Protobuf]
            .into_iter()
            .find(|known| known.as_str() == encoding)
            .ok_or_else(|| format!("its messages are {encoding:?}, expected \"cdr\""))?;
        let name =
            type_name.ok_or_else(|| "it has no schema, so that its type is unknown".to_owned())?;
        match found {
            Self::Cdr => {
                let canonical = canonical_type_name(name);
                let name = canonical
                    .map_err(|_| format!("its type is {name:?}, expected package/msg/Type"))?;
                Ok((found, name))
            }
            Self::Protobuf if PROTOBUF_TYPES.contains(&name) => Ok((found, name.to_owned())),
            Self::Protobuf => Err(format!(
                "its messages are \"protobuf\" of the type {name:?}, expected \"cdr\", or \"protobuf\" of {}",
                PROTOBUF_TYPES.join(", ")
            )),
        }
    }
}
