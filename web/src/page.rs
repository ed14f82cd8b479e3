//! The files of the page, compiled into the program.

/// Path, media type, content.
pub(crate) const FILES: [(&str, &str, &str); 14] = [
    (
        "/",
        "text/html; charset=utf-8",
        include_str!("../page/index.html"),
    ),
    (
        "/style.css",
        "text/css; charset=utf-8",
        include_str!("../page/style.css"),
    ),
    (
        "/page.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/page.js"),
    ),
    (
        "/map.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/map.js"),
    ),
    (
        "/alarms.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/alarms.js"),
    ),
    (
        "/charts.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/charts.js"),
    ),
    (
        "/playback",
        "text/html; charset=utf-8",
        include_str!("../page/playback.html"),
    ),
    (
        "/common.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/common.js"),
    ),
    (
        "/course.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/course.js"),
    ),
    (
        "/playback.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/playback.js"),
    ),
    (
        "/uncertainty.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/uncertainty.js"),
    ),
    (
        "/region.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/region.js"),
    ),
    (
        "/sheets",
        "text/html; charset=utf-8",
        include_str!("../page/sheets.html"),
    ),
    (
        "/sheets.js",
        "text/javascript; charset=utf-8",
        include_str!("../page/sheets.js"),
    ),
];
