//! The files of the page, compiled into the program.

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";

/// Path, media type, content.
pub(crate) const FILES: [(&str, &str, &str); 14] = [
    ("/", HTML, include_str!("../page/index.html")),
    ("/style.css", CSS, include_str!("../page/style.css")),
    ("/page.js", JS, include_str!("../page/page.js")),
    ("/map.js", JS, include_str!("../page/map.js")),
    ("/alarms.js", JS, include_str!("../page/alarms.js")),
    ("/charts.js", JS, include_str!("../page/charts.js")),
    ("/playback", HTML, include_str!("../page/playback.html")),
    ("/common.js", JS, include_str!("../page/common.js")),
    ("/course.js", JS, include_str!("../page/course.js")),
    ("/playback.js", JS, include_str!("../page/playback.js")),
    (
        "/uncertainty.js",
        JS,
        include_str!("../page/uncertainty.js"),
    ),
    ("/region.js", JS, include_str!("../page/region.js")),
    ("/sheets", HTML, include_str!("../page/sheets.html")),
    ("/sheets.js", JS, include_str!("../page/sheets.js")),
];
