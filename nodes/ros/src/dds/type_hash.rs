//! The hash of a topic's type, which endpoints announce in their user data (REP 2016).

const KEY: &[u8] = b"typehash=";
/// The prefix of version 1; 64 hexadecimal digits follow.
const VERSION: &str = "RIHS01_";
const DIGITS: usize = 64;

/// The hash in the user data of an endpoint, for example `typehash=RIHS01_...;`; `None` if missing.
pub(super) fn announced(user_data: &[u8]) -> Option<String> {
    let at = user_data
        .windows(KEY.len())
        .position(|window| window == KEY)?;
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
            format!("typehash={HASH}"),
        ] {
            assert_eq!(
                announced(text.as_bytes()).as_deref(),
                Some(HASH),
                "{text:?}"
            );
        }
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
