use super::*;
use crate::judges::Result;

fn parse(more: &str) -> Result<EndpointSettings> {
    let yaml = format!("name: a\nbase_url: http://localhost:8000/v1\nmodel: m\n{more}");
    let settings: EndpointSettings = crate::judges::text_file::parse("a judge", &yaml)?;
    settings.check()?;
    Ok(settings)
}

#[test]
fn optional_keys_have_defaults() {
    let settings = parse("").unwrap();
    assert_eq!(
        settings,
        EndpointSettings::new("a", "http://localhost:8000/v1", "m")
    );
    let settings =
        parse("temperature: null\nbody: {chat_template_kwargs: {enable_thinking: false}}").unwrap();
    assert_eq!(settings.temperature, None);
    assert_eq!(
        settings.body["chat_template_kwargs"]["enable_thinking"],
        false
    );
}

#[test]
fn invalid_values_are_rejected_by_name() {
    for (more, named) in [
        ("temperature: -1", "temperature is -1, expected 0 or more"),
        ("temperature: .nan", "temperature"),
        ("max_tokens: 0", "max_tokens"),
        ("timeout_s: 0", "1 to 86400"),
        ("reasks: 11", "reasks is 11"),
        ("requests_per_minute: 0", "requests_per_minute"),
        ("price_per_million: {input: -1}", "price_per_million"),
        ("max_cost: 5", "price_per_million too"),
        ("picture: {quality: 101}", "picture.quality"),
        ("picture: {format: gif}", "gif"),
        ("body: {n: 2}", "body is with n"),
        ("api_key_env: abcdef0123", "capital letters, digits and _"),
        ("api_key: sk-0123", "api_key"),
    ] {
        let error = parse(more).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
    let urls = [
        "ftp://a",
        "http://",
        "http:///v1",
        "http://u:p@a/v1",
        "http://a/v1?x",
        "http://a b",
        "a/v1",
    ];
    for url in urls {
        let error = EndpointSettings::new("a", url, "m")
            .check()
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("base_url") && !error.contains("u:p"),
            "{error}"
        );
    }
}

#[test]
fn https_needs_a_feature() {
    let checked = EndpointSettings::new("a", "https://api.example/v1", "m").check();
    if cfg!(feature = "https") {
        checked.unwrap();
    } else {
        let error = checked.unwrap_err().to_string();
        assert!(error.contains("feature `https`"), "{error}");
    }
}

#[test]
fn prices_are_per_million_tokens() {
    let price = Price {
        input: 2.0,
        output: 10.0,
    };
    let usage = Usage {
        input_tokens: 500_000,
        output_tokens: 100_000,
    };
    assert_eq!(price.of(usage), 2.0);
}
