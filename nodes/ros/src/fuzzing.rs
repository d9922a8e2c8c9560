//! Entry points for the fuzz targets into parsers that are otherwise private. Not part of the API.

use crate::rcl_interfaces::{ListRequest, LoggerLevels, Names, ParameterEvent, ParametersToSet};
use wm_msgs::cdr;

/// Decodes a sample of the topic on which participants exchange parts of large messages.
pub fn part(sample: &[u8]) {
    crate::dds::decode_part(sample);
}

/// Decodes the requests of the parameter and logger services.
pub fn request(bytes: &[u8]) {
    cdr::from_bytes::<ListRequest>(bytes).ok();
    cdr::from_bytes::<LoggerLevels>(bytes).ok();
    cdr::from_bytes::<Names>(bytes).ok();
    cdr::from_bytes::<ParameterEvent>(bytes).ok();
    cdr::from_bytes::<ParametersToSet>(bytes).ok();
}
