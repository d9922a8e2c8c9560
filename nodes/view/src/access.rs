//! Access control: hosts, origins and the token.
//!
//! The page is served over HTTP on loopback. Two kinds of requests that other pages can make a browser send are
//! refused: requests of another origin (by `Origin`), and requests to a name that was bound to this address later, by
//! DNS rebinding (by `Host`). An address cannot be rebound; names other than localhost are accepted only if the user
//! has listed them.
//!
//! Viewers with Foxglove's protocol are pages of other origins. Listed origins may use this protocol, but neither the
//! page's socket nor its pictures.

use crate::{ViewError, subprotocol};
use axum::http::{HeaderMap, StatusCode, header};
use std::{
    fmt::Write as _,
    net::{IpAddr, Ipv6Addr, SocketAddr},
    path::Path,
};

/// The prefix of the token in a further subprotocol: a page cannot set headers of a browser's WebSocket.
const TOKEN_PROTOCOL: &str = "wm.token.";
/// Lengths of a token that the user chose.
const TOKEN_LENGTHS: std::ops::RangeInclusive<usize> = 16..=256;

#[derive(Debug)]
pub(crate) struct Access {
    hosts: Vec<String>,
    token: Option<String>,
    viewers: Vec<String>,
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refusal {
    /// The request names another host.
    Host,
    /// The request comes from another page.
    Origin,
    /// The token is missing or wrong.
    Token,
}

impl Refusal {
    pub(crate) const fn status(self) -> StatusCode {
        match self {
            Self::Host => StatusCode::MISDIRECTED_REQUEST,
            Self::Origin => StatusCode::FORBIDDEN,
            Self::Token => StatusCode::UNAUTHORIZED,
        }
    }

    pub(crate) const fn text(self) -> &'static str {
        match self {
            Self::Host => {
                "this name is not this host's: use its address, or list the name in the parameter hosts"
            }
            Self::Origin => "requests of other pages are refused",
            Self::Token => "a token is needed: open the address that the node has printed",
        }
    }
}

impl Access {
    /// Allows these names besides addresses and localhost; requires `token` if given.
    pub(crate) fn new(hosts: Vec<String>, token: Option<String>) -> Self {
        Self {
            hosts,
            token,
            viewers: Vec::new(),
        }
    }

    /// Also allows viewers of these origins.
    ///
    /// # Errors
    /// An entry is not an origin.
    pub(crate) fn with_viewers(self, viewers: Vec<String>) -> Result<Self, ViewError> {
        // files have no authority
        let is_origin = |text: &String| {
            let parts = text.split_once("://");
            parts.is_some_and(|(scheme, rest)| !scheme.is_empty() && !rest.contains('/'))
        };
        match viewers.iter().find(|viewer| !is_origin(viewer)) {
            Some(other) => Err(ViewError::Origin(other.clone())),
            None => Ok(Self { viewers, ..self }),
        }
    }

    /// Checks that a request names this host and comes from its own page or an allowed viewer.
    ///
    /// # Errors
    /// It does not.
    pub(crate) fn check_viewer(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let origin = headers.get(header::ORIGIN);
        let is_listed = origin
            .and_then(|origin| origin.to_str().ok())
            .is_some_and(|origin| {
                let mut viewers = self.viewers.iter();
                viewers.any(|viewer| viewer.eq_ignore_ascii_case(origin))
            });
        match self.check_origin(headers) {
            Err(Refusal::Origin) if is_listed => Ok(()),
            checked => checked,
        }
    }

    /// Checks that a request names this host and comes from its own page.
    ///
    /// # Errors
    /// It does not.
    pub(crate) fn check_origin(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let text = |name| headers.get(name).map(|value| value.to_str().unwrap_or(""));
        let host = text(header::HOST).ok_or(Refusal::Host)?;
        if !self.is_own(name_of(host)) {
            return Err(Refusal::Host);
        }
        // programs other than browsers send no origin
        let Some(origin) = text(header::ORIGIN) else {
            return Ok(());
        };
        let (_, authority) = origin.split_once("://").ok_or(Refusal::Origin)?;
        if authority.eq_ignore_ascii_case(host) {
            Ok(())
        } else {
            Err(Refusal::Origin)
        }
    }

    /// Checks the token, as `Authorization: Bearer` or as a subprotocol. `query`: also as `token=` there, for viewers
    /// whose user can only give an address.
    ///
    /// # Errors
    /// It is missing or wrong.
    pub(crate) fn check_token(
        &self,
        headers: &HeaderMap,
        query: Option<&str>,
    ) -> Result<(), Refusal> {
        let Some(token) = &self.token else {
            return Ok(());
        };
        let bearer = headers.get(header::AUTHORIZATION);
        let bearer = bearer.and_then(|value| value.to_str().ok()?.strip_prefix("Bearer "));
        let protocols = subprotocol::offered(headers);
        let pairs = query.unwrap_or_default().split('&');
        let mut given = protocols
            .filter_map(|protocol| protocol.strip_prefix(TOKEN_PROTOCOL))
            .chain(pairs.filter_map(|pair| pair.strip_prefix("token=")))
            .chain(bearer);
        if given.any(|given| is_same(given, token)) {
            Ok(())
        } else {
            Err(Refusal::Token)
        }
    }

    fn is_own(&self, name: &str) -> bool {
        name.parse::<IpAddr>().is_ok()
            || name.eq_ignore_ascii_case("localhost")
            || self
                .hosts
                .iter()
                .any(|host| name.eq_ignore_ascii_case(host))
    }

    /// The address to open.
    pub(crate) fn url(&self, address: SocketAddr) -> String {
        let mut shown = address;
        if address.ip().is_unspecified() {
            // the unspecified address cannot be opened; loopback can, on this host
            shown.set_ip(match address.ip() {
                IpAddr::V4(_) => [127, 0, 0, 1].into(),
                IpAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
            });
        }
        match &self.token {
            // browsers do not send the part after #
            Some(token) => format!("http://{shown}/#token={token}"),
            None => format!("http://{shown}/"),
        }
    }
}

/// The host without its port; an IPv6 address without its brackets.
fn name_of(host: &str) -> &str {
    if let Some(rest) = host.strip_prefix('[') {
        return rest.split_once(']').map_or("", |(name, _)| name);
    }
    host.split_once(':').map_or(host, |(name, _)| name)
}

/// Compares in constant time.
fn is_same(given: &str, token: &str) -> bool {
    let pairs = given.bytes().zip(token.bytes());
    let differing = pairs.fold(0, |all, (a, b)| all | (a ^ b));
    given.len() == token.len() && std::hint::black_box(differing) == 0
}

/// The token for a page on this address: from the file or, if other hosts can reach the address, a new one.
///
/// # Errors
/// The file cannot be read, or contains no token.
pub(crate) fn token(address: IpAddr, file: &Path) -> Result<Option<String>, ViewError> {
    if file.as_os_str().is_empty() {
        return Ok((!address.is_loopback()).then(new_token));
    }
    let text = std::fs::read_to_string(file).map_err(|reason| ViewError::TokenFile {
        path: file.to_owned(),
        reason,
    })?;
    let token = text.lines().next().unwrap_or("").trim();
    let is_allowed = |c: char| c.is_ascii_alphanumeric() || "._~-".contains(c);
    if TOKEN_LENGTHS.contains(&token.len()) && token.chars().all(is_allowed) {
        return Ok(Some(token.to_owned()));
    }
    Err(ViewError::Token {
        path: file.to_owned(),
        length: token.len(),
    })
}

/// 128 random bits.
fn new_token() -> String {
    let bytes: [u8; 16] = rand::random();
    bytes.iter().fold(String::new(), |mut text, byte| {
        // writing to a text cannot fail
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderName;
    use proptest::prelude::*;

    fn headers(pairs: &[(HeaderName, &str)]) -> HeaderMap {
        let pairs = pairs.iter();
        pairs
            .map(|(name, value)| (name.clone(), value.parse().unwrap()))
            .collect()
    }

    fn of(host: &str, origin: Option<&str>) -> Result<(), Refusal> {
        let access = Access::new(vec!["robot.local".to_owned()], None);
        let host = (header::HOST, host);
        let origin = origin.map(|origin| (header::ORIGIN, origin));
        let pairs: Vec<_> = std::iter::once(host).chain(origin).collect();
        access.check_origin(&headers(&pairs))
    }

    #[test]
    fn addresses_localhost_and_listed_names_are_this_host() {
        for host in [
            "127.0.0.1:8765",
            "localhost",
            "LocalHost:1",
            "[::1]:8765",
            "10.0.0.7:8765",
            "robot.local:8765",
        ] {
            assert_eq!(of(host, None), Ok(()), "{host}");
        }
        for host in [
            "evil.example:8765",
            "127.0.0.1.evil.example",
            "",
            "[::1",
            "localhost.evil.example:8765",
        ] {
            assert_eq!(of(host, None), Err(Refusal::Host), "{host}");
        }
        let none = Access::new(Vec::new(), None).check_origin(&HeaderMap::new());
        assert_eq!(none, Err(Refusal::Host));
    }

    #[test]
    fn only_the_pages_own_origin_is_accepted() {
        let host = "127.0.0.1:8765";
        assert_eq!(of(host, Some("http://127.0.0.1:8765")), Ok(()));
        for origin in [
            "http://evil.example",
            "http://127.0.0.1:9999",
            "http://localhost:8765",
            "null",
            "",
        ] {
            assert_eq!(of(host, Some(origin)), Err(Refusal::Origin), "{origin}");
        }
    }

    #[test]
    fn listed_viewer_origins_are_accepted() {
        let listed = ["file://", "https://app.foxglove.dev"].map(str::to_owned);
        let access = Access::new(Vec::new(), None)
            .with_viewers(listed.to_vec())
            .unwrap();
        let check = |host: &str, origin: &str| {
            let headers = headers(&[(header::HOST, host), (header::ORIGIN, origin)]);
            (access.check_viewer(&headers), access.check_origin(&headers))
        };
        let host = "127.0.0.1:8765";
        for origin in ["file://", "https://app.foxglove.dev"] {
            assert_eq!(check(host, origin), (Ok(()), Err(Refusal::Origin)));
        }
        for origin in [
            "null",
            "file:///home",
            "http://app.foxglove.dev",
            "https://app.foxglove.dev.evil.example",
            "https://evil.example",
        ] {
            assert_eq!(check(host, origin).0, Err(Refusal::Origin), "{origin}");
        }
        assert_eq!(check(host, "http://127.0.0.1:8765"), (Ok(()), Ok(())));
        let rebound = check("evil.example", "https://app.foxglove.dev");
        assert_eq!(rebound.0, Err(Refusal::Host));
        for none in ["*", "app.foxglove.dev", "https://app.foxglove.dev/", "://a"] {
            let made = Access::new(Vec::new(), None).with_viewers(vec![none.to_owned()]);
            assert!(made.is_err(), "{none}");
        }
    }

    #[test]
    fn token_is_accepted_as_header_or_subprotocol() {
        let access = Access::new(Vec::new(), Some("secret-secret-secret".to_owned()));
        let check =
            |name: HeaderName, value: &str| access.check_token(&headers(&[(name, value)]), None);
        let protocol = header::SEC_WEBSOCKET_PROTOCOL;
        assert_eq!(
            check(header::AUTHORIZATION, "Bearer secret-secret-secret"),
            Ok(())
        );
        assert_eq!(
            check(
                protocol.clone(),
                "wm.view.v1, wm.token.secret-secret-secret"
            ),
            Ok(())
        );
        for (name, value) in [
            (header::AUTHORIZATION, "Bearer secret-secret-secre"),
            (header::AUTHORIZATION, "secret-secret-secret"),
            (protocol.clone(), "wm.view.v1"),
            (protocol, "wm.token.secret-secret-secret2"),
        ] {
            assert_eq!(check(name, value), Err(Refusal::Token), "{value}");
        }
        let none = HeaderMap::new();
        assert_eq!(
            Access::new(Vec::new(), None).check_token(&none, None),
            Ok(())
        );
        for (query, is_right) in [
            ("token=secret-secret-secret", true),
            ("a=b&token=secret-secret-secret", true),
            ("token=", false),
            ("", false),
            ("xtoken=secret-secret-secret", false),
        ] {
            let checked = access.check_token(&none, Some(query));
            assert_eq!(checked.is_ok(), is_right, "{query}");
        }
    }

    #[test]
    fn token_is_required_beyond_loopback() {
        let none = Path::new("");
        assert_eq!(token([127, 0, 0, 1].into(), none).unwrap(), None);
        let first = token([0, 0, 0, 0].into(), none).unwrap().unwrap();
        assert_eq!(first.len(), 32);
        assert_ne!(Some(first), token([10, 0, 0, 7].into(), none).unwrap());

        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("token");
        assert!(matches!(
            token([127, 0, 0, 1].into(), &file),
            Err(ViewError::TokenFile { .. })
        ));
        for wrong in ["short", "with spaces in it, and long", ""] {
            std::fs::write(&file, wrong).unwrap();
            let error = token([127, 0, 0, 1].into(), &file).unwrap_err();
            assert!(matches!(error, ViewError::Token { .. }), "{error}");
        }
        std::fs::write(&file, "0123456789abcdef\n").unwrap();
        let own = token([127, 0, 0, 1].into(), &file).unwrap();
        assert_eq!(own.as_deref(), Some("0123456789abcdef"));
        let url = Access::new(Vec::new(), own).url(([0, 0, 0, 0], 80).into());
        assert_eq!(url, "http://127.0.0.1:80/#token=0123456789abcdef");
    }

    proptest! {
        #[test]
        fn whatever_the_headers_are_they_are_judged(host in "[ -~]{0,40}", origin in "[ -~]{0,40}") {
            let _ = of(&host, Some(&origin));
        }

        #[test]
        fn only_equal_tokens_are_the_same(a in "[a-f0-9]{0,8}", b in "[a-f0-9]{0,8}") {
            prop_assert_eq!(is_same(&a, &b), a == b);
        }
    }
}
