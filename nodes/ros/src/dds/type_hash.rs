//! The hash of a topic's type, which endpoints announce in their user data (REP 2016).

const KEY: &[u8] = b"typehash=";
/// The prefix of version 1; 64 hexadecimal digits follow.
const VERSION: &str = "RIHS01_";
const DIGITS: usize = 64;

/// The hash in the user data of an endpoint; `None` if missing.
///
/// The user data consists of `key=value;`, for example `typehash=RIHS01_...;sertypehash=RIHS01_...;bufbe=cpu:;`. The keys
/// after the hash, of ROS 2 Lyrical, are ignored: the hash of a service, and the backends of buffers.
pub(super) fn announced(user_data: &[u8]) -> Option<String> {
    // rustdds 0.15.1 leaves the length of the data, 4 bytes, at its beginning
    let is_key = |at: usize| at == 0 || at == 4 || user_data.get(at - 1) == Some(&b';');
    let windows = user_data.windows(KEY.len()).enumerate();
    let mut keys = windows.filter(|(at, window)| *window == KEY && is_key(*at));
    let (at, _) = keys.next()?;
    let rest = user_data.get(at + KEY.len()..)?;
    let hash = std::str::from_utf8(rest.get(..VERSION.len() + DIGITS)?).ok()?;
    let digits = hash.strip_prefix(VERSION)?;
    let is_end = matches!(rest.get(VERSION.len() + DIGITS), None | Some(b';' | 0));
    let is_hexadecimal = digits.bytes().all(|byte| byte.is_ascii_hexdigit());
    (is_end && is_hexadecimal).then(|| hash.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

    #[test]
    fn hash_is_found_between_other_keys() {
        for text in [
            format!("typehash={HASH};"),
            format!("\u{5}\0\0\0enclave=/;typehash={HASH};other=1;"),
            format!("\u{5d}\0\0\0typehash={HASH};"),
            format!("\0\0\0\u{5d}typehash={HASH};"),
            format!("typehash={HASH}"),
        ] {
            assert_eq!(
                announced(text.as_bytes()).as_deref(),
                Some(HASH),
                "{text:?}"
            );
        }
    }

    /// ROS 2 Lyrical: `rmw_fastrtps_cpp` adds the backends of buffers, and an identity to the writers for single readers.
    #[test]
    fn keys_of_lyrical_are_no_hashes() {
        let other = HASH.replace("df", "00");
        let backends = format!("bufbe=cpu:,cuda:{}", "device=0 ".repeat(30));
        for text in [
            format!("typehash={HASH};sertypehash={other};bufbe=cpu:;"),
            format!("sertypehash={other};typehash={HASH};bufbe=cpu:;"),
            format!("{backends};typehash={HASH};"),
            format!("typehash={HASH};{backends};PGID:{}", "0a".repeat(16)),
            format!("bufbe=cpu:typehash={other};typehash={HASH};"),
        ] {
            assert_eq!(
                announced(text.as_bytes()).as_deref(),
                Some(HASH),
                "{text:?}"
            );
        }
        let only = format!("sertypehash={other};bufbe=cpu:;");
        assert_eq!(announced(only.as_bytes()), None);
    }

    #[test]
    fn invalid_hashes_are_ignored() {
        for text in [
            String::new(),
            "typehash=".to_owned(),
            "typehash=RIHS01_00;".to_owned(),
            format!("typehash={HASH}00;"),
            format!("typehash={};", HASH.replace("RIHS01", "RIHS02")),
            format!("typehash={};", HASH.replace("df", "/x")),
        ] {
            assert_eq!(announced(text.as_bytes()), None, "{text:?}");
        }
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            announced(&bytes);
            announced(&[KEY, &bytes].concat());
        }
    }
}
