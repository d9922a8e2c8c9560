//! Why the view cannot start.

use std::{net::SocketAddr, path::PathBuf};
use thiserror::Error;

#[derive(Debug, Error)]
#[non_exhaustive]
pub(crate) enum ViewError {
    /// The address is taken, or not of this machine.
    #[error(
        "cannot serve the page on {address}: {reason}; choose another port with `--port PORT` (in a launch file `view_port:=PORT`); 0 is any free one"
    )]
    Listen {
        address: SocketAddr,
        reason: std::io::Error,
    },
    /// The parameter `address` is not an address.
    #[error("parameter \"address\" is \"{0}\", expected an IP address such as 127.0.0.1 or ::1")]
    Address(String),
    #[error("cannot read the token file {}: {reason}", path.display())]
    TokenFile {
        path: PathBuf,
        reason: std::io::Error,
    },
    /// The file's content is not a token.
    #[error(
        "the token in {} has {length} characters, or invalid ones; expected 16 to 256 of A-Z a-z 0-9 . _ ~ -",
        path.display()
    )]
    Token {
        path: PathBuf,
        /// The length of its first line.
        length: usize,
    },
    /// An invalid entry of the parameter `foxglove_rates`.
    #[error(
        "parameter \"foxglove_rates\" has \"{0}\", expected EXPRESSION=HZ such as ^/camera/=5, of at most 1000000 Hz and at \
         least one message a day"
    )]
    Rate(String),
    /// An invalid entry of the parameter `foxglove_origins`.
    #[error(
        "parameter \"foxglove_origins\" has \"{0}\", expected an origin such as https://app.foxglove.dev, without a path"
    )]
    Origin(String),
    /// An invalid regular expression.
    #[error(transparent)]
    Topics(#[from] wm_bag::BagError),
    /// The parameter `axes` is not three directions.
    #[error(
        "parameter \"axes\" has {0} numbers, expected 6, right and down for each of x, y and z"
    )]
    Axes(usize),
}
