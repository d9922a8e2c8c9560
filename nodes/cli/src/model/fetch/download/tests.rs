use super::*;
use std::fs;
use std::io::{BufRead as _, BufReader};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};

fn headers(etag: &str) -> HeaderMap {
    let mut headers = HeaderMap::new();
    headers.insert(LINKED_ETAG, etag.parse().unwrap());
    headers
}

#[test]
fn only_a_sha256_is_accepted_as_one() {
    let sha = "0123456789abcdef".repeat(4);
    assert_eq!(
        linked_sha256(&headers(&format!("\"{sha}\""))),
        Some(sha.clone())
    );
    assert_eq!(
        linked_sha256(&headers(&format!("W/\"{}\"", sha.to_uppercase()))),
        Some(sha)
    );
    assert_eq!(
        linked_sha256(&headers("\"da39a3ee5e6b4b0d3255bfef95601890afd80709\"")),
        None
    );
    assert_eq!(linked_sha256(&HeaderMap::new()), None);
}

#[test]
fn files_are_hashed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("abc");
    fs::write(&path, "abc").unwrap();
    let (hash, length) = hash_file(&path).unwrap();
    let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!((hex(&hash).as_str(), length), (expected, 3));
}

/// A server on loopback with scripted responses, one after the other; every HEAD gets the same one.
struct Server {
    url: String,
    /// The headers of the requests for the file, in lower case.
    requests: Arc<Mutex<Vec<String>>>,
}

impl Server {
    fn start(head: String, answers: Vec<String>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/model", listener.local_addr().unwrap());
        let requests = Arc::new(Mutex::new(Vec::new()));
        let seen = requests.clone();
        std::thread::spawn(move || {
            let mut answers = answers.into_iter();
            for stream in listener.incoming() {
                let mut stream = stream.unwrap();
                let mut lines = BufReader::new(&stream).lines();
                let lines = std::iter::from_fn(|| lines.next()?.ok());
                let request: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
                let request = request.join("\n").to_lowercase();
                let answer = if request.starts_with("head") {
                    head.clone()
                } else {
                    seen.lock().unwrap().push(request);
                    answers
                        .next()
                        .unwrap_or_else(|| answer("500 Too Much", "", ""))
                };
                stream.write_all(answer.as_bytes()).unwrap();
            }
        });
        Self { url, requests }
    }

    fn client() -> Client {
        let agent = settings().proxy(None).build().into();
        Client { agent, token: None }
    }

    fn fetch(&self, path: &Path) -> Result<String> {
        self.fetch_pinned(path, None, false)
    }

    fn fetch_pinned(&self, path: &Path, pinned: Option<&str>, overwrite: bool) -> Result<String> {
        let client = Self::client();
        let stated = client.stated(&self.url)?;
        client.fetch(&Request {
            url: &self.url,
            path,
            stated: stated.sha256.as_deref(),
            pinned,
            overwrite,
        })
    }

    fn request(&self, number: usize) -> String {
        self.requests.lock().unwrap()[number].clone()
    }
}

fn answer(status: &str, headers: &str, body: &str) -> String {
    cut_off(status, headers, body, body.len())
}

/// A truncated response.
fn cut_off(status: &str, headers: &str, beginning: &str, length: usize) -> String {
    format!(
        "HTTP/1.1 {status}\r\nConnection: close\r\nContent-Length: {length}\r\n{headers}\r\n{beginning}"
    )
}

fn sha256(text: &str) -> String {
    hex(&Sha256::new().chain_update(text))
}

/// Downloads `the old file`, interrupted after seven bytes, and then from `answers`. Returns the file, and the headers
/// of the requests after the first.
fn resumed(head: &str, first: &str, answers: &[String]) -> (Result<String>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    let mut all = vec![cut_off("200 OK", first, "the old", 12)];
    all.extend_from_slice(answers);
    let server = Server::start(answer("200 OK", head, ""), all);
    let error = server.fetch(&path).unwrap_err();
    assert!(format!("{error:#}").contains("after 7 bytes"), "{error:#}");
    let fetched = server.fetch(&path).map(|fetched| {
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(fetched, sha256(&text));
        text
    });
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(left.len(), usize::from(fetched.is_ok()), "{left:?}");
    let requests = (1..=answers.len()).map(|number| server.request(number));
    (fetched, requests.collect())
}

const OLD: &str = "ETag: \"old\"\r\n";
const NEW: &str = "ETag: \"new\"\r\n";

#[test]
fn interrupted_download_resumes() {
    let rest = format!("{OLD}Content-Range: bytes 7-11/12\r\n");
    let rest = answer("206 Partial Content", &rest, " file");
    let (file, requests) = resumed("", OLD, &[rest]);
    assert_eq!(file.unwrap(), "the old file");
    assert!(requests[0].contains("range: bytes=7-"), "{requests:?}");
    assert!(requests[0].contains("if-range: \"old\""), "{requests:?}");
}

#[test]
fn changed_file_is_downloaded_from_its_beginning() {
    let whole = answer("200 OK", NEW, "the new file");
    let (file, _) = resumed("", OLD, &[whole]);
    assert_eq!(file.unwrap(), "the new file");
}

#[test]
fn unexpected_ranges_are_rejected() {
    let part = |headers: &str| answer("206 Partial Content", headers, " file");
    for unfit in [
        part(&format!("{NEW}Content-Range: bytes 7-11/12\r\n")),
        part(&format!("{OLD}Content-Range: bytes 0-4/12\r\n")),
        part(OLD),
        answer(
            "416 Range Not Satisfiable",
            "Content-Range: bytes */5\r\n",
            "",
        ),
    ] {
        let (file, requests) = resumed("", OLD, &[unfit, answer("200 OK", NEW, "the new file")]);
        assert_eq!(file.unwrap(), "the new file");
        assert!(!requests[1].contains("range"), "{requests:?}");
    }
}

#[test]
fn download_without_strong_entity_tag_does_not_resume() {
    for first in ["", "ETag: W/\"old\"\r\n"] {
        let (file, requests) = resumed("", first, &[answer("200 OK", first, "the old file")]);
        assert_eq!(file.unwrap(), "the old file");
        assert!(!requests[0].contains("range"), "{requests:?}");
    }
}

#[test]
fn stated_hash_decides() {
    let head = format!("{LINKED_ETAG}: \"{}\"\r\n", sha256("the old file"));
    let rest = format!("{OLD}Content-Range: bytes 7-11/12\r\n");
    let good = answer("206 Partial Content", &rest, " file");
    assert_eq!(resumed(&head, OLD, &[good]).0.unwrap(), "the old file");
    let bad = answer("206 Partial Content", &rest, " fire");
    let error = resumed(&head, OLD, &[bad]).0.unwrap_err().to_string();
    assert!(error.contains("not the expected file"), "{error}");
}

#[test]
fn complete_download_is_only_renamed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    let part = Part::of(&path);
    part.begin(Some("\"old\""))
        .unwrap()
        .write_all(b"all")
        .unwrap();
    let end = format!("{OLD}Content-Range: bytes */3\r\n");
    let end = answer("416 Range Not Satisfiable", &end, "");
    let server = Server::start(answer("200 OK", "", ""), vec![end]);
    assert_eq!(server.fetch(&path).unwrap(), sha256("all"));
    assert_eq!(fs::read_to_string(&path).unwrap(), "all");
}

#[test]
fn different_file_is_replaced_only_with_overwrite() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    fs::write(&path, "mine").unwrap();
    let head = format!("{LINKED_ETAG}: \"{}\"\r\n", sha256("theirs"));
    let server = Server::start(
        answer("200 OK", &head, ""),
        vec![answer("200 OK", "", "theirs")],
    );
    let error = server.fetch(&path).unwrap_err().to_string();
    assert!(error.contains("--overwrite"), "{error}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
    let found = server.fetch_pinned(&path, None, true).unwrap();
    assert_eq!(found, sha256("theirs"));
    assert_eq!(fs::read_to_string(&path).unwrap(), "theirs");
}

#[test]
fn only_the_pinned_file_is_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    let pinned = sha256("the old file");
    // if the server states no hash, the received bytes decide
    for head in [
        String::new(),
        format!("{LINKED_ETAG}: \"{}\"\r\n", sha256("the new file")),
    ] {
        let file = answer("200 OK", "", "the new file");
        let server = Server::start(answer("200 OK", &head, ""), vec![file]);
        let error = server.fetch_pinned(&path, Some(&pinned), false);
        let error = error.unwrap_err().to_string();
        assert!(error.contains(&pinned), "{error}");
        assert!(!path.exists());
    }
    let file = answer("200 OK", "", "the new file");
    let server = Server::start(answer("200 OK", "", ""), vec![file]);
    server.fetch_pinned(&path, Some(&pinned), true).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "the new file");
}

#[test]
fn branch_is_resolved_to_its_commit() {
    let commit = "0123456789abcdef0123456789abcdef01234567";
    for (stated, expected) in [(commit, Some(commit)), ("../../other", None)] {
        let head = answer("200 OK", &format!("{REPO_COMMIT}: {stated}\r\n"), "");
        let server = Server::start(head, Vec::new());
        let stated = Server::client().stated(&server.url).unwrap();
        assert_eq!(stated.commit.as_deref(), expected);
    }
}
