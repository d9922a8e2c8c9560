//! How the messages of a channel are encoded.

use crate::schema::canonical_type_name;

/// Types whose messages are kept if they are protocol buffers: pictures as Foxglove's tools record them. `wm_camera`
/// decodes them.
pub const PROTOBUF_TYPES: [&str; 3] = [
    "foxglove.CompressedImage",
    "foxglove.CompressedVideo",
    "foxglove.RawImage",
];

/// An encoding of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageEncoding {
    /// CDR, as everywhere in ROS 2.
    Cdr,
    /// Protocol buffers, of [`PROTOBUF_TYPES`] alone.
    Protobuf,
}

impl MessageEncoding {
    /// The name in files, as MCAP and rosbag2 have it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cdr => "cdr",
            Self::Protobuf => "protobuf",
        }
    }

    /// Encoding and type of a channel with messages in `encoding` of the type `type_name`, if it has one.
    ///
    /// # Errors
    /// Why its messages cannot be read.
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
