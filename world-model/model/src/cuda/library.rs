//! A library, and the functions of it that are called.

use std::error::Error as _;
use std::ffi::c_void;
use std::path::Path;
use std::sync::atomic::{AtomicPtr, Ordering};

use libloading::Library as Loaded;

/// Where a function goes on to: an address that is filled in when its library has been loaded.
#[repr(transparent)]
pub(crate) struct Slot(AtomicPtr<c_void>);

impl Slot {
    pub(crate) const fn new() -> Self {
        Self(AtomicPtr::new(not_loaded as extern "C" fn() as *mut c_void))
    }

    fn fill(&self, address: *mut c_void) {
        self.0.store(address, Ordering::Release);
    }
}

/// What a function does whose library has not been loaded: nothing could be returned that every caller understands.
extern "C" fn not_loaded() {
    eprintln!("a function of CUDA was called before its library was loaded");
    std::process::abort();
}

/// A library.
pub(crate) struct Library {
    /// Its file's names, those of later releases first.
    pub(crate) files: &'static [&'static str],
    /// What it is part of, and how to come by it.
    pub(crate) part_of: &'static str,
    /// Functions by name, and where each goes on to.
    pub(crate) functions: &'static [(&'static str, &'static Slot)],
}

/// What is missing of CUDA.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Missing {
    /// A library.
    #[error("{} cannot be loaded: {reason}. It is part of {part_of}", .files.join(" or "))]
    Library {
        /// The names that were tried.
        files: Vec<&'static str>,
        /// What the system said of the first one.
        reason: String,
        /// What it is part of, and how to come by it.
        part_of: &'static str,
    },
    /// A function of a library that is there.
    #[error(
        "{file} has no function {function}: expected that of CUDA 12 or 13. It is part of {part_of}"
    )]
    Function {
        /// The library.
        file: &'static str,
        /// The function's name.
        function: &'static str,
        /// What it is part of, and how to come by it.
        part_of: &'static str,
    },
}

/// Loads `libraries`, from `folder` or from wherever the system looks for libraries, and fills in all slots.
pub(crate) fn load(libraries: &'static [Library], folder: Option<&Path>) -> Result<(), Missing> {
    for library in libraries {
        library.load(folder)?;
    }
    Ok(())
}

impl Library {
    fn load(&self, folder: Option<&Path>) -> Result<(), Missing> {
        let mut refused = None;
        for file in self.files {
            match open(file, folder) {
                Ok(loaded) => return self.fill(file, loaded),
                Err(reason) => refused = refused.or(Some(reason)),
            }
        }
        Err(Missing::Library {
            files: self.files.to_vec(),
            // Each library has at least one file, so there is a reason.
            reason: refused.unwrap_or_default(),
            part_of: self.part_of,
        })
    }

    fn fill(&self, file: &'static str, loaded: Loaded) -> Result<(), Missing> {
        for (name, slot) in self.functions {
            // SAFETY: the address is only jumped to, from the function of the same name.
            let function = unsafe { loaded.get::<*mut c_void>(*name) };
            let Ok(function) = function else {
                return Err(Missing::Function {
                    file,
                    function: name,
                    part_of: self.part_of,
                });
            };
            slot.fill(*function);
        }
        // Its functions are called for as long as the process runs.
        std::mem::forget(loaded);
        Ok(())
    }
}

fn open(file: &str, folder: Option<&Path>) -> Result<Loaded, String> {
    let path = folder.map_or_else(|| file.into(), |folder| folder.join(file));
    // SAFETY: what NVIDIA's libraries do when they are loaded is what any program of CUDA has done.
    let loaded = unsafe { Loaded::new(path) };
    // Its source is what the system said.
    loaded.map_err(|error| match error.source() {
        Some(source) => source.to_string(),
        None => error.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::process::Command;

    use super::*;

    #[test]
    fn what_is_missing_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let none = load(crate::cuda::functions::libraries(), Some(folder.path())).unwrap_err();
        let message = none.to_string();
        let expected = [
            "libcuda.so.1 cannot be loaded",
            "NVIDIA driver",
            folder.path().to_str().unwrap(),
        ];
        for part in expected {
            assert!(message.contains(part), "{message}");
        }
    }

    /// A library that a C compiler made of `source`.
    fn built(folder: &Path, file: &str, source: &str) -> PathBuf {
        let (c, library) = (folder.join("source.c"), folder.join(file));
        std::fs::write(&c, source).unwrap();
        let mut cc = Command::new("cc");
        cc.args(["-shared", "-fPIC", "-o"]).arg(&library).arg(&c);
        assert!(cc.status().unwrap().success());
        library
    }

    // Two functions, of which no library of CUDA is the owner.
    crate::cuda::functions::forwarded! {
        fn tested;
        ["libtested.so.2", "libtested.so.1"] of "the tests" {
            wm_cuda_test_sum, wm_cuda_test_name
        }
    }

    unsafe extern "C" {
        #[link_name = "wm_cuda_test_sum"]
        fn sum(a: i32, b: f64, c: u64, d: f32, e: i32, f: i64, g: u8, h: i32, i: i32) -> f64;
        #[link_name = "wm_cuda_test_name"]
        fn name() -> *const std::ffi::c_char;
    }

    /// Arguments in registers of both kinds and on the stack.
    const SOURCE: &str =
        "double wm_cuda_test_sum(int a, double b, unsigned long c, float d, int e, long f,
        unsigned char g, int h, int i) {
            return a + 10 * b + 100 * c + 1e3 * d + 1e4 * e + 1e5 * f + 1e6 * g + 1e7 * h + 1e8 * i;
        }";

    #[test]
    fn calls_reach_the_library_with_all_arguments() {
        let folder = tempfile::tempdir().unwrap();
        built(folder.path(), "libtested.so.1", SOURCE);
        let message = load(tested(), Some(folder.path())).unwrap_err().to_string();
        assert!(
            message.contains("libtested.so.1 has no function wm_cuda_test_name"),
            "{message}"
        );
        let named =
            format!("{SOURCE}\nconst char *wm_cuda_test_name(void) {{ return \"second\"; }}");
        built(folder.path(), "libtested.so.2", &named);
        load(tested(), Some(folder.path())).unwrap();
        // SAFETY: the types are those of the source, and the library has been loaded.
        let (sum, name) = unsafe { (sum(1, 2.0, 3, 4.0, 5, 6, 7, 8, 9), name()) };
        assert_eq!(sum, 987_654_321.0);
        // SAFETY: a string of C, of a library that stays loaded.
        let name = unsafe { std::ffi::CStr::from_ptr(name) };
        assert_eq!(name.to_str(), Ok("second"));
    }
}
