//! Why the view cannot start.

use std::{net::SocketAddr, path::PathBuf};
use thiserror::Error;

/// Why the view cannot start.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ViewError {
    /// The address is taken, or none of this machine's.
    #[error(
        "cannot serve the page on {address}: {reason}; another port is `port:=PORT`, any free one `port:=0`"
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
    /// The parameter `axes` is not three directions.
    #[error(
        "parameter \"axes\" has {0} numbers, expected 6, right and down for each of x, y and z"
    )]
    Axes(usize),
}
