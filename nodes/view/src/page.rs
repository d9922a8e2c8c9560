//! The page's files: plain HTML, CSS and JavaScript.

pub(crate) struct File {
    pub path: &'static str,
    pub media_type: &'static str,
    pub text: &'static str,
}

const SCRIPT: &str = "text/javascript; charset=utf-8";

macro_rules! files {
    ($($path:literal => $media_type:expr, $name:literal;)*) => {
        &[$(File {
            path: $path,
            media_type: $media_type,
            text: include_str!(concat!("../page/", $name)),
        }),*]
    };
}

pub(crate) const FILES: &[File] = files! {
    "/" => "text/html; charset=utf-8", "index.html";
    "/view.css" => "text/css; charset=utf-8", "view.css";
    "/icon.svg" => "image/svg+xml", "icon.svg";
    "/main.js" => SCRIPT, "main.js";
    "/charts.js" => SCRIPT, "charts.js";
    "/controls.js" => SCRIPT, "controls.js";
    "/panels.js" => SCRIPT, "panels.js";
    "/pictures.js" => SCRIPT, "pictures.js";
    "/record.js" => SCRIPT, "record.js";
    "/socket.js" => SCRIPT, "socket.js";
};

/// The page may only load its own files and connect to its own host. No other page may frame it, where a click could be
/// misdirected.
pub(crate) const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest page \[byte\].
    const LIMIT: usize = 150_000;

    #[test]
    fn page_is_small_and_needs_no_network() {
        let size: usize = FILES.iter().map(|file| file.text.len()).sum();
        assert!(size < LIMIT, "{size}");
        for file in FILES {
            let is_foreign = |url: &&str| !url.starts_with("http://www.w3.org/");
            let urls = file
                .text
                .match_indices("http")
                .map(|(at, _)| &file.text[at..]);
            let mut foreign =
                urls.filter(|text| text.starts_with("http://") || text.starts_with("https://"));
            assert_eq!(foreign.find(is_foreign), None, "{}", file.path);
        }
    }

    #[test]
    fn every_named_file_exists() {
        let has = |path: &str| FILES.iter().any(|file| file.path == path);
        for file in FILES {
            let quoted = file
                .text
                .split(['"', '\''])
                .filter(|text| text.starts_with("./"));
            for name in quoted {
                assert!(has(name.trim_start_matches('.')), "{}: {name}", file.path);
            }
        }
    }
}
