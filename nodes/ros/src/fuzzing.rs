//! Entry points for the fuzz targets into parsers that are otherwise private. Not part of the API.

use wm_msgs::{
    cdr,
    rcl_interfaces::{
        GetParametersRequest, ListParametersRequest, ParameterEvent, SetLoggerLevelsRequest,
        SetParametersRequest,
    },
};

/// Decodes a sample of the topic on which participants exchange parts of large messages.
pub fn part(sample: &[u8]) {
    crate::dds::decode_part(sample);
}

/// Decodes the requests of the parameter and logger services.
pub fn request(bytes: &[u8]) {
    cdr::from_bytes::<ListParametersRequest>(bytes).ok();
    cdr::from_bytes::<SetLoggerLevelsRequest>(bytes).ok();
    cdr::from_bytes::<GetParametersRequest>(bytes).ok();
    cdr::from_bytes::<ParameterEvent>(bytes).ok();
    cdr::from_bytes::<SetParametersRequest>(bytes).ok();
}
