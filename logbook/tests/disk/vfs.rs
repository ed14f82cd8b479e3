//! A wrapper around SQLite's own file layer (VFS) that records every write, truncation, sync and deletion of a file,
//! and can make them fail. The files are real files in their usual places.
//!
//! `unsafe` because SQLite accepts a file layer only as a table of C functions. The wrapper copies the tables of the
//! present layer, replaces five functions in them by functions that record the call and forward it, and makes the
//! copy the default. After a call it retains nothing of SQLite's memory except the address of an open file, which
//! serves as its name.

#![allow(unsafe_code)]

use std::collections::HashMap;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, Once, PoisonError};

use rusqlite::ffi;

/// An operation on a file, or a mark of the test.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Operation {
    /// Created, or opened.
    Open,
    Write {
        offset: usize,
        bytes: Vec<u8>,
    },
    Truncate(usize),
    Sync,
    Delete {
        /// Whether its folder was synced too.
        lasting: bool,
    },
    /// A mark of the test: what is acknowledged at this point.
    Mark(Mark),
}

/// What has been acknowledged to the writer at this point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Mark {
    /// Frames handed over, and those acknowledged.
    pub handed: u64,
    pub kept: u64,
    pub events_handed: usize,
    pub events_kept: usize,
    pub baseline: bool,
    pub closed: bool,
}

/// One operation and the name of its file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    pub file: String,
    pub operation: Operation,
}

/// A fault to inject in a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// Every sync of a file whose name ends with `of`, except the first `after` ones.
    Sync { of: &'static str, after: u32 },
    /// Every write beyond `space` bytes from now on.
    Full { space: usize },
}

#[derive(Default)]
struct State {
    steps: Vec<(PathBuf, Step)>,
    faults: HashMap<PathBuf, Fault>,
    /// Keyed by the address of SQLite's file object.
    open: HashMap<usize, (PathBuf, Original)>,
}

/// A file's original table of functions.
#[derive(Clone, Copy)]
struct Original(*const ffi::sqlite3_io_methods);

// SAFETY: SQLite's tables are constants for the life of the program.
unsafe impl Send for Original {}

static STATE: Mutex<Option<State>> = Mutex::new(None);

fn state() -> MutexGuard<'static, Option<State>> {
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn with<T>(act: impl FnOnce(&mut State) -> T) -> T {
    act(state().get_or_insert_with(State::default))
}

/// Records all operations of this process from now on.
pub fn record() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // SAFETY: the default layer exists after initialisation and until the end of the program; the copy is leaked,
        // so it does too. Registering it does not change the original.
        unsafe {
            ffi::sqlite3_initialize();
            let real = ffi::sqlite3_vfs_find(std::ptr::null());
            assert!(!real.is_null());
            let copy = Box::leak(Box::new(std::ptr::read(real)));
            copy.zName = c"tactus-listening".as_ptr();
            copy.pNext = std::ptr::null_mut();
            copy.xOpen = Some(open);
            copy.xDelete = Some(delete);
            REAL.store(real, std::sync::atomic::Ordering::SeqCst);
            assert_eq!(ffi::sqlite3_vfs_register(copy, 1), ffi::SQLITE_OK);
        }
    });
}

static REAL: std::sync::atomic::AtomicPtr<ffi::sqlite3_vfs> =
    std::sync::atomic::AtomicPtr::new(std::ptr::null_mut());

/// All operations in a folder so far.
pub fn steps(folder: &Path) -> Vec<Step> {
    let within = |(path, _): &&(PathBuf, Step)| path.starts_with(folder);
    with(|state| {
        let steps = state.steps.iter().filter(within);
        steps.map(|(_, step)| step.clone()).collect()
    })
}

/// Records what has been acknowledged to the writer.
pub fn mark(folder: &Path, mark: Mark) {
    note(folder.to_owned(), Operation::Mark(mark));
}

/// Injects a fault in a folder, or ends it (`None`).
pub fn fail(folder: &Path, fault: Option<Fault>) {
    with(|state| match fault {
        Some(fault) => drop(state.faults.insert(folder.to_owned(), fault)),
        None => drop(state.faults.remove(folder)),
    });
}

fn note(path: PathBuf, operation: Operation) {
    let file = path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default();
    // The index of a journal is rebuilt after a power cut, so operations on it do not matter.
    if !file.ends_with("-shm") {
        with(|state| state.steps.push((path, Step { file, operation })));
    }
}

/// The error for a write of this number of bytes, or for a sync (`None`); `None` if it succeeds.
fn fault(path: &Path, writing: Option<usize>) -> Option<c_int> {
    with(|state| {
        let fault = state.faults.get_mut(path.parent()?)?;
        match (fault, writing) {
            (Fault::Full { space }, Some(bytes)) if bytes > *space => {
                *space = 0;
                Some(ffi::SQLITE_FULL)
            }
            (Fault::Full { space }, Some(bytes)) => {
                *space -= bytes;
                None
            }
            (Fault::Sync { of, after }, None) if path.to_string_lossy().ends_with(*of) => {
                if *after == 0 {
                    return Some(ffi::SQLITE_IOERR_FSYNC);
                }
                *after -= 1;
                None
            }
            _ => None,
        }
    })
}

fn known(file: *mut ffi::sqlite3_file) -> (PathBuf, Original) {
    with(|state| state.open[&(file as usize)].clone())
}

unsafe extern "C" fn open(
    _: *mut ffi::sqlite3_vfs,
    name: ffi::sqlite3_filename,
    file: *mut ffi::sqlite3_file,
    flags: c_int,
    out: *mut c_int,
) -> c_int {
    let real = REAL.load(std::sync::atomic::Ordering::SeqCst);
    // SAFETY: `real` is the original layer; all arguments are SQLite's own, for this very function.
    let answer = unsafe { (*real).xOpen.expect("it opens files")(real, name, file, flags, out) };
    if answer != ffi::SQLITE_OK || name.is_null() {
        return answer;
    }
    // SAFETY: after a successful open the file has its table and its name is a C string. The changed copy is leaked,
    // because the file may stay open after this function has returned.
    unsafe {
        let path = PathBuf::from(CStr::from_ptr(name).to_string_lossy().into_owned());
        let original = (*file).pMethods;
        let methods = Box::leak(Box::new(std::ptr::read(original)));
        methods.xWrite = Some(write);
        methods.xTruncate = Some(truncate);
        methods.xSync = Some(sync);
        methods.xClose = Some(close);
        (*file).pMethods = methods;
        with(|state| {
            let known = (path.clone(), Original(original));
            state.open.insert(file as usize, known)
        });
        if flags & ffi::SQLITE_OPEN_READONLY == 0 {
            note(path, Operation::Open);
        }
    }
    answer
}

unsafe extern "C" fn delete(_: *mut ffi::sqlite3_vfs, name: *const c_char, sync: c_int) -> c_int {
    let real = REAL.load(std::sync::atomic::Ordering::SeqCst);
    // SAFETY: as in `open`.
    let answer = unsafe { (*real).xDelete.expect("it deletes files")(real, name, sync) };
    if answer == ffi::SQLITE_OK {
        // SAFETY: a file is deleted by its name, a C string.
        let path = unsafe { CStr::from_ptr(name) };
        note(
            PathBuf::from(path.to_string_lossy().into_owned()),
            Operation::Delete { lasting: sync != 0 },
        );
    }
    answer
}

unsafe extern "C" fn close(file: *mut ffi::sqlite3_file) -> c_int {
    let found = with(|state| state.open.remove(&(file as usize)));
    let (_, Original(methods)) = found.expect("only open files are closed");
    // SAFETY: the file's own function.
    unsafe { (*methods).xClose.expect("it closes files")(file) }
}

unsafe extern "C" fn write(
    file: *mut ffi::sqlite3_file,
    bytes: *const c_void,
    count: c_int,
    offset: ffi::sqlite3_int64,
) -> c_int {
    let (path, Original(methods)) = known(file);
    if let Some(refusal) = fault(&path, Some(count as usize)) {
        return refusal;
    }
    // SAFETY: SQLite passes `count` bytes at `bytes`; the function is the file's own.
    let (answer, bytes) = unsafe {
        let whole = std::slice::from_raw_parts(bytes.cast::<u8>(), count as usize);
        let write = (*methods).xWrite.expect("it writes files");
        (write(file, bytes, count, offset), whole.to_vec())
    };
    if answer == ffi::SQLITE_OK {
        let offset = offset as usize;
        note(path, Operation::Write { offset, bytes });
    }
    answer
}

unsafe extern "C" fn truncate(file: *mut ffi::sqlite3_file, size: ffi::sqlite3_int64) -> c_int {
    let (path, Original(methods)) = known(file);
    // SAFETY: the file's own function.
    let answer = unsafe { (*methods).xTruncate.expect("it truncates files")(file, size) };
    if answer == ffi::SQLITE_OK {
        note(path, Operation::Truncate(size as usize));
    }
    answer
}

unsafe extern "C" fn sync(file: *mut ffi::sqlite3_file, flags: c_int) -> c_int {
    let (path, Original(methods)) = known(file);
    if let Some(refusal) = fault(&path, None) {
        return refusal;
    }
    // No real sync is needed: the images define the effect of a sync.
    let _ = (methods, flags);
    note(path, Operation::Sync);
    ffi::SQLITE_OK
}
