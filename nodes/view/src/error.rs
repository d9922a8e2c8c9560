//! Why the view cannot start.

use std::{net::SocketAddr, path::PathBuf};
use thiserror::Error;

/// Why the view cannot start.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ViewError {
    /// The address is taken, or none of this machine's.
    #[error(
        "cannot serve the page on {address}: {reason}; choose another port with `--port PORT` (in a launch file `view_port:=PORT`); 0 is any free one"
    )]
    Listen {
        /// Where.
        address: SocketAddr,
        /// Why not.
        reason: std::io::Error,
    },
    /// The parameter `address` is no address.
    #[error("parameter \"address\" is \"{0}\", expected an IP address such as 127.0.0.1 or ::1")]
    Address(String),
    /// The file of the token cannot be read.
    #[error("cannot read the token file {}: {reason}", path.display())]
    TokenFile {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: std::io::Error,
    },
    /// What is in it is no token.
    #[error(
        "the token in {} has {length} characters, or some that a token may not have; expected 16 to 256 of A-Z a-z 0-9 . _ ~ -",
        path.display()
    )]
    Token {
        /// The file.
        path: PathBuf,
        /// How long its first line is.
        length: usize,
    },
    /// An entry of the parameter `foxglove_rates` is none.
    #[error(
        "parameter \"foxglove_rates\" has \"{0}\", expected EXPRESSION=HZ such as ^/camera/=5, of at most 1000000 Hz and at \
         least one message a day"
    )]
    Rate(String),
    /// An entry of the parameter `foxglove_origins` is none.
    #[error(
        "parameter \"foxglove_origins\" has \"{0}\", expected an origin such as https://app.foxglove.dev, without a path"
    )]
    Origin(String),
    /// A regular expression is none.
    #[error(transparent)]
    Topics(#[from] wm_bag::BagError),
    /// The parameter `axes` is not three directions.
    #[error(
        "parameter \"axes\" has {0} numbers, expected 6, right and down for each of x, y and z"
    )]
    Axes(usize),
}
