//! The cache that a user has.

use std::ffi::OsString;
use std::path::PathBuf;

use super::{CacheLimits, PackedCache};

/// Names another folder, or says `off`.
const FOLDER: &str = "WM_PACKED_CACHE";
const OFF: &str = "off";

impl PackedCache {
    /// That of the user: in the folder that `WM_PACKED_CACHE` names, else in `wm/packed` of the user's cache directory
    /// (`XDG_CACHE_HOME`, or `~/.cache`). `None` if `WM_PACKED_CACHE` is `off`, or there is no such directory.
    pub fn of_environment() -> Option<Self> {
        let folder = folder(|name| std::env::var_os(name))?;
        Some(Self::new(folder, CacheLimits::default()))
    }
}

fn folder(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let path = |name| {
        let value = variable(name).filter(|value| !value.is_empty());
        value.map(PathBuf::from)
    };
    if let Some(folder) = path(FOLDER) {
        return (folder.as_os_str() != OFF).then_some(folder);
    }
    // The specification has relative ones ignored.
    let caches = path("XDG_CACHE_HOME").filter(|folder| folder.is_absolute());
    let caches = caches.or_else(|| {
        let home = path("HOME").filter(|home| home.is_absolute());
        home.map(|home| home.join(".cache"))
    });
    Some(caches?.join("wm/packed"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_is_the_users() {
        type Variables<'a> = &'a [(&'a str, &'a str)];
        let cases: [(Variables<'_>, Option<&str>); 8] = [
            (&[], None),
            (&[("HOME", "/home/me")], Some("/home/me/.cache/wm/packed")),
            (&[("HOME", "me")], None),
            (
                &[("HOME", "/home/me"), ("XDG_CACHE_HOME", "/var/me")],
                Some("/var/me/wm/packed"),
            ),
            (
                &[("HOME", "/home/me"), ("XDG_CACHE_HOME", "caches")],
                Some("/home/me/.cache/wm/packed"),
            ),
            (
                &[("HOME", "/home/me"), ("WM_PACKED_CACHE", "/data/wm")],
                Some("/data/wm"),
            ),
            (&[("HOME", "/home/me"), ("WM_PACKED_CACHE", "off")], None),
            (
                &[("HOME", "/home/me"), ("WM_PACKED_CACHE", "")],
                Some("/home/me/.cache/wm/packed"),
            ),
        ];
        for (variables, expected) in cases {
            let variable = |name: &str| {
                let found = variables.iter().find(|(known, _)| *known == name);
                found.map(|(_, value)| OsString::from(value))
            };
            assert_eq!(
                folder(variable),
                expected.map(PathBuf::from),
                "{variables:?}"
            );
        }
    }
}
