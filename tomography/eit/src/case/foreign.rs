//! Detects files of other formats given as CSV, and explains how to convert them.

/// The format of a file that is not CSV, and how to convert it; `None` if it may be CSV.
pub(super) fn format(bytes: &[u8]) -> Option<[String; 2]> {
    let named = |what: &str, remedy: &str| Some([what.to_owned(), remedy.to_owned()]);
    let numpy = "numpy.savetxt('FILE.csv', array, delimiter=',', fmt='%.17g')";
    if bytes.starts_with(b"\x93NUMPY") {
        let remedy = format!("write it as CSV in Python: array = numpy.load('FILE'); {numpy}");
        return named("a NumPy array (.npy)", &remedy);
    }
    // version 7.3 is HDF5 after a block of 512 bytes that begins like version 5
    if bytes.starts_with(b"MATLAB 5.0 MAT-file") || bytes.starts_with(b"MATLAB 7.3 MAT-file") {
        let remedy = format!(
            "write its matrix as CSV, in MATLAB: writematrix(X, 'FILE.csv'), or in Python: array = \
             scipy.io.loadmat('FILE')['X']; {numpy}"
        );
        return named("a MATLAB file (.mat)", &remedy);
    }
    if bytes.starts_with(b"\x89HDF\r\n\x1a\n") {
        let remedy = format!(
            "write its data set as CSV in Python: array = h5py.File('FILE')['X'][:]; {numpy}"
        );
        return named("an HDF5 file", &remedy);
    }
    if bytes.starts_with(b"PK\x03\x04") {
        return named(
            "a ZIP file, as .xlsx and .npz are",
            "save one sheet or one array of it as CSV",
        );
    }
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        return named("text in UTF-16", "save it as CSV in UTF-8");
    }
    let Ok(text) = std::str::from_utf8(bytes) else {
        return named("not text in UTF-8", "save it as CSV in UTF-8");
    };
    // two lines: the first may be a header
    let lines = text.lines().filter(|line| !line.trim().is_empty()).take(2);
    for line in lines {
        for field in line.split(',').map(str::trim) {
            for (separator, name) in [('\t', "tabs"), (';', "semicolons")] {
                if field.contains(separator) {
                    return named(
                        &format!("separated by {name}"),
                        "separate the fields by commas, and write decimals with a point",
                    );
                }
            }
        }
        let numbers = |line: &str| {
            line.split_whitespace()
                .all(|part| part.parse::<f64>().is_ok())
        };
        if !line.contains(',') && line.split_whitespace().count() > 1 && numbers(line) {
            return named("separated by spaces", "separate the fields by commas");
        }
    }
    None
}
