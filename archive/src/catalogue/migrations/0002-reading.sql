-- What readers need: the tracked baseline that a session began with, and the state of all machines.

-- Maps of a session with a tracked baseline depend on the state that it began with.
CREATE TABLE tactus.tracking (
    site text NOT NULL,
    daq text NOT NULL,
    session text NOT NULL,
    state text NOT NULL,
    PRIMARY KEY (site, daq, session),
    FOREIGN KEY (site, daq, session) REFERENCES tactus.session (site, daq, session)
);
GRANT SELECT ON tactus.tracking TO tactus_uploader, tactus_reader;
GRANT INSERT ON tactus.tracking TO tactus_uploader;
ALTER TABLE tactus.tracking ENABLE ROW LEVEL SECURITY;
CREATE POLICY own_rows ON tactus.tracking FOR SELECT TO tactus_uploader
    USING (site IN (SELECT name FROM tactus.site WHERE role = current_user));
CREATE POLICY own_additions ON tactus.tracking FOR INSERT TO tactus_uploader
    WITH CHECK (site IN (SELECT name FROM tactus.site WHERE role = current_user));
CREATE POLICY every_row ON tactus.tracking FOR SELECT TO tactus_reader USING (true);

CREATE INDEX alarm_by_name ON tactus.alarm (site, daq, alarm, at);
CREATE INDEX event_by_time ON tactus.event (site, daq, at);

-- Every machine that sent something, by one look into an index for each: the table of quantities is too long to be read.
CREATE VIEW tactus.machine WITH (security_invoker = true) AS
WITH RECURSIVE measuring AS (
    (SELECT site, daq FROM tactus.quantity ORDER BY site, daq LIMIT 1)
    UNION ALL
    SELECT next.site, next.daq
    FROM measuring AS m
    CROSS JOIN LATERAL (
        SELECT q.site, q.daq FROM tactus.quantity AS q WHERE (q.site, q.daq) > (m.site, m.daq) ORDER BY q.site, q.daq LIMIT 1
    ) AS next
)
SELECT site, daq FROM measuring
UNION
SELECT site, daq FROM tactus.session;

-- A minute that lies ahead of the clock of this server says nothing about how long a machine is silent.
CREATE OR REPLACE VIEW tactus.daq_summary WITH (security_invoker = true) AS
SELECT
    m.site, m.daq,
    p.parts, p.frames, p.bytes, p.last_frame, p.last_archived, q.last_quantity,
    extract(epoch FROM now() - greatest(
        p.last_archived,
        CASE WHEN q.last_quantity < now() + interval '5 minutes' THEN q.last_quantity END
    ))::double precision AS silent_s
FROM tactus.machine AS m
LEFT JOIN (
    SELECT site, daq, count(*) AS parts, sum(frames)::bigint AS frames, sum(bytes)::bigint AS bytes,
        max(last) AS last_frame, max(archived_at) AS last_archived
    FROM tactus.part GROUP BY site, daq
) AS p USING (site, daq)
LEFT JOIN LATERAL (
    SELECT max(begin) AS last_quantity FROM tactus.quantity AS q WHERE q.site = m.site AND q.daq = m.daq
) AS q ON true;

-- An alarm of a machine as its last events in the archive left it.
CREATE VIEW tactus.alarm_state WITH (security_invoker = true) AS
SELECT
    a.site, a.daq, a.alarm,
    coalesce(c.change IN ('active', 'held'), false) AS active,
    coalesce(v.change = 'invalid', false) AS invalid,
    greatest(c.at, v.at) AS changed,
    CASE WHEN c.at IS NULL OR v.at > c.at THEN v.text ELSE c.text END AS text
FROM (SELECT DISTINCT site, daq, alarm FROM tactus.alarm) AS a
LEFT JOIN LATERAL (
    SELECT l.change, l.at, l.text FROM tactus.alarm AS l
    WHERE l.site = a.site AND l.daq = a.daq AND l.alarm = a.alarm AND l.change IN ('active', 'held', 'over')
    ORDER BY l.at DESC, l.part DESC, l.number DESC LIMIT 1
) AS c ON true
LEFT JOIN LATERAL (
    SELECT l.change, l.at, l.text FROM tactus.alarm AS l
    WHERE l.site = a.site AND l.daq = a.daq AND l.alarm = a.alarm AND l.change IN ('invalid', 'judged')
    ORDER BY l.at DESC, l.part DESC, l.number DESC LIMIT 1
) AS v ON true;

-- A row for each machine: what it sent last, how far its maps are known to be true, its alarms.
CREATE VIEW tactus.machine_state WITH (security_invoker = true) AS
SELECT
    d.site, d.daq,
    -- the newest of what was archived and what is measured now
    CASE WHEN p.session IS NULL OR q.begin > p.started THEN coalesce(q.session, p.session) ELSE p.session END AS session,
    s.simulated,
    coalesce(d.parts, 0) AS parts, coalesce(d.frames, 0) AS frames, coalesce(d.bytes, 0) AS bytes,
    d.last_frame, d.last_archived, d.last_quantity, d.silent_s,
    CASE WHEN d.last_quantity >= now() + interval '5 minutes'
        THEN extract(epoch FROM d.last_quantity - now())::double precision END AS clock_ahead_s,
    k.known,
    coalesce(a.alarms, '{}') AS alarms, coalesce(a.invalid_alarms, '{}') AS invalid_alarms
FROM tactus.daq_summary AS d
LEFT JOIN LATERAL (
    SELECT session, started FROM tactus.part AS p WHERE p.site = d.site AND p.daq = d.daq ORDER BY started DESC LIMIT 1
) AS p ON true
LEFT JOIN tactus.session AS s ON s.site = d.site AND s.daq = d.daq AND s.session = p.session
LEFT JOIN LATERAL (
    SELECT session, begin FROM tactus.quantity AS q WHERE q.site = d.site AND q.daq = d.daq ORDER BY begin DESC LIMIT 1
) AS q ON true
LEFT JOIN LATERAL (
    -- only one number of each row is taken out: the others cost most of the time
    SELECT sum((v.known ->> 1)::double precision * (v.known ->> 3)::bigint) / nullif(sum((v.known ->> 3)::bigint), 0) AS known
    FROM (
        SELECT region -> 'values' -> 'known' AS known
        FROM tactus.quantity AS r CROSS JOIN LATERAL json_array_elements(r.span -> 'regions') AS region
        WHERE r.site = d.site AND r.daq = d.daq AND r.begin > d.last_quantity - interval '10 minutes'
            AND region ->> 'name' = 'sheet'
    ) AS v
) AS k ON true
LEFT JOIN (
    SELECT site, daq,
        array_agg(alarm ORDER BY alarm) FILTER (WHERE active) AS alarms,
        array_agg(alarm ORDER BY alarm) FILTER (WHERE invalid) AS invalid_alarms
    FROM tactus.alarm_state GROUP BY site, daq
) AS a ON a.site = d.site AND a.daq = d.daq;

-- Quantities an hour, for dashboards of months.
CREATE VIEW tactus.quantity_hour WITH (security_invoker = true) AS
SELECT
    site, daq, region, quantity, of,
    date_trunc('hour', begin) AS hour,
    min(min) AS min,
    sum(mean * frames) / nullif(sum(frames), 0) AS mean,
    max(max) AS max,
    sum(frames)::bigint AS frames,
    sum(known)::bigint AS known
FROM tactus.quantity_value
GROUP BY site, daq, region, quantity, of, date_trunc('hour', begin);

GRANT SELECT ON tactus.machine, tactus.alarm_state, tactus.machine_state, tactus.quantity_hour TO tactus_uploader, tactus_reader;
