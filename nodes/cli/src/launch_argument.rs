//! A launch argument on the command line.

/// Parses `NAME:=VALUE`.
pub(crate) fn parse(text: &str) -> Result<(String, String), String> {
    match text.split_once(":=") {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("expected name:=value".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn launch_arguments_need_a_name() {
        assert_eq!(parse("a:=b:=c"), Ok(("a".to_owned(), "b:=c".to_owned())));
        assert!(parse(":=b").is_err());
        assert!(parse("a=b").is_err());
    }
}
