-- The catalogue of the archive. Rows are only inserted: a part, its events and its quantities never change.
-- Needs PostgreSQL 15 (views with the rights of their reader).

CREATE SCHEMA tactus;

CREATE TABLE tactus.migration (
    version integer PRIMARY KEY,
    name text NOT NULL,
    applied_at timestamptz NOT NULL DEFAULT now()
);

-- A site and the role of the database that may write and read its rows.
CREATE TABLE tactus.site (
    name text PRIMARY KEY CHECK (name ~ '^[a-z0-9][a-z0-9_-]{0,63}$'),
    role name NOT NULL,
    added_at timestamptz NOT NULL DEFAULT now()
);

-- What all parts of a session have in common.
CREATE TABLE tactus.session (
    site text NOT NULL REFERENCES tactus.site (name),
    daq text NOT NULL CHECK (daq ~ '^[a-z0-9][a-z0-9_-]{0,63}$'),
    session text NOT NULL,
    kind text NOT NULL CHECK (kind IN ('baseline', 'measurement')),
    simulated boolean NOT NULL,
    electrodes integer NOT NULL,
    readings integer NOT NULL,
    build text NOT NULL,
    config_sha256 text NOT NULL,
    model_sha256 text,
    note text NOT NULL,
    about jsonb NOT NULL,
    instruments jsonb NOT NULL,
    PRIMARY KEY (site, daq, session)
);

-- A closed part: one immutable file of the store.
CREATE TABLE tactus.part (
    site text NOT NULL,
    daq text NOT NULL,
    part text NOT NULL,
    session text NOT NULL,
    sha256 bytea NOT NULL CHECK (octet_length(sha256) = 32),
    bytes bigint NOT NULL CHECK (bytes > 0),
    stored_as text NOT NULL,
    continues text,
    first_sequence bigint NOT NULL,
    frames bigint NOT NULL CHECK (frames >= 0),
    started timestamptz NOT NULL,
    last timestamptz,
    closed timestamptz NOT NULL,
    closed_reason text NOT NULL,
    archived_at timestamptz NOT NULL DEFAULT clock_timestamp(),
    PRIMARY KEY (site, daq, part),
    FOREIGN KEY (site, daq, session) REFERENCES tactus.session (site, daq, session)
);
CREATE INDEX part_of_session ON tactus.part (site, daq, session);
CREATE INDEX part_by_time ON tactus.part (started);

CREATE TABLE tactus.event (
    site text NOT NULL,
    daq text NOT NULL,
    part text NOT NULL,
    number integer NOT NULL CHECK (number > 0),
    at timestamptz NOT NULL,
    kind text NOT NULL,
    text text NOT NULL,
    PRIMARY KEY (site, daq, part, number),
    FOREIGN KEY (site, daq, part) REFERENCES tactus.part (site, daq, part)
);
CREATE INDEX event_by_kind ON tactus.event (kind, at);

-- Events of alarms, with the name of the alarm.
CREATE TABLE tactus.alarm (
    site text NOT NULL,
    daq text NOT NULL,
    part text NOT NULL,
    number integer NOT NULL,
    at timestamptz NOT NULL,
    alarm text NOT NULL,
    change text NOT NULL,
    text text NOT NULL,
    PRIMARY KEY (site, daq, part, number),
    FOREIGN KEY (site, daq, part, number) REFERENCES tactus.event (site, daq, part, number)
);
CREATE INDEX alarm_by_time ON tactus.alarm (site, daq, at);

-- A line of a session's quantities: one minute. The view quantity_value has a row for each number.
CREATE TABLE tactus.quantity (
    site text NOT NULL,
    daq text NOT NULL,
    session text NOT NULL,
    line integer NOT NULL CHECK (line > 0),
    begin timestamptz NOT NULL,
    span json NOT NULL,
    PRIMARY KEY (site, daq, session, line),
    FOREIGN KEY (site) REFERENCES tactus.site (name)
);
CREATE INDEX quantity_by_time ON tactus.quantity (site, daq, begin);

CREATE VIEW tactus.quantity_value WITH (security_invoker = true) AS
SELECT
    q.site, q.daq, q.session, q.line, q.begin,
    region ->> 'name' AS region,
    value.key AS quantity,
    q.span ->> 'of' AS of,
    (value.value ->> 0)::double precision AS min,
    (value.value ->> 1)::double precision AS mean,
    (value.value ->> 2)::double precision AS max,
    (value.value ->> 3)::bigint AS frames,
    (value.value ->> 4)::bigint AS known
FROM tactus.quantity AS q
CROSS JOIN LATERAL json_array_elements(q.span -> 'regions') AS region
CROSS JOIN LATERAL json_each(region -> 'values') AS value;

-- A session over its parts. `complete`: it ended, and no frame between its first and last part is missing.
CREATE VIEW tactus.session_summary WITH (security_invoker = true) AS
WITH numbered AS (
    SELECT p.*, lead(first_sequence) OVER parts AS next_first, lag(part) OVER parts AS before
    FROM tactus.part AS p
    WINDOW parts AS (PARTITION BY site, daq, session ORDER BY first_sequence, started)
), summed AS (
    SELECT
        site, daq, session,
        count(*) AS parts,
        sum(frames)::bigint AS frames,
        sum(bytes)::bigint AS bytes,
        min(started) AS started,
        max(last) AS last,
        max(closed) AS closed,
        (array_agg(closed_reason ORDER BY first_sequence DESC, started DESC))[1] AS closed_reason,
        bool_and(next_first IS NULL OR next_first = first_sequence + frames)
            AND bool_and(continues IS NOT DISTINCT FROM before) AS contiguous
    FROM numbered
    GROUP BY site, daq, session
)
SELECT
    s.site, s.daq, s.session, s.kind, s.simulated, s.electrodes, s.readings, s.build, s.note, s.about,
    t.parts, t.frames, t.bytes, t.started, t.last, t.closed, t.closed_reason,
    t.contiguous AND t.closed_reason NOT LIKE 'continued in %' AS complete
FROM tactus.session AS s
JOIN summed AS t USING (site, daq, session);

-- A row for each machine: what it sent, and how long ago.
CREATE VIEW tactus.daq_summary WITH (security_invoker = true) AS
SELECT
    site, daq,
    p.parts, p.frames, p.bytes, p.last_frame, p.last_archived, q.last_quantity,
    extract(epoch FROM now() - greatest(p.last_archived, q.last_quantity))::double precision AS silent_s
FROM (
    SELECT site, daq, count(*) AS parts, sum(frames)::bigint AS frames, sum(bytes)::bigint AS bytes,
        max(last) AS last_frame, max(archived_at) AS last_archived
    FROM tactus.part GROUP BY site, daq
) AS p
FULL JOIN (
    SELECT site, daq, max(begin) AS last_quantity FROM tactus.quantity GROUP BY site, daq
) AS q USING (site, daq);

-- Whose a site is, for a message that names it: 'own', 'other' or 'none'. Its rows are not shown to others.
CREATE FUNCTION tactus.site_state(wanted text) RETURNS text
LANGUAGE sql STABLE SECURITY DEFINER SET search_path = pg_catalog, pg_temp
AS $$
    SELECT coalesce(
        (SELECT CASE WHEN role = session_user THEN 'own' ELSE 'other' END FROM tactus.site WHERE name = wanted),
        'none')
$$;
REVOKE ALL ON FUNCTION tactus.site_state(text) FROM PUBLIC;

-- The two groups. Roles belong to the whole server: they may exist already.
DO $$
BEGIN
    IF NOT EXISTS (SELECT FROM pg_catalog.pg_roles WHERE rolname = 'tactus_uploader') THEN
        CREATE ROLE tactus_uploader NOLOGIN;
    END IF;
    IF NOT EXISTS (SELECT FROM pg_catalog.pg_roles WHERE rolname = 'tactus_reader') THEN
        CREATE ROLE tactus_reader NOLOGIN;
    END IF;
END
$$;

GRANT USAGE ON SCHEMA tactus TO tactus_uploader, tactus_reader;
GRANT EXECUTE ON FUNCTION tactus.site_state(text) TO tactus_uploader, tactus_reader;
GRANT SELECT ON ALL TABLES IN SCHEMA tactus TO tactus_uploader, tactus_reader;
GRANT INSERT ON tactus.session, tactus.part, tactus.event, tactus.alarm, tactus.quantity TO tactus_uploader;

-- An uploader sees and adds rows of its own sites only; a reader sees all.
DO $$
DECLARE
    named text;
BEGIN
    EXECUTE 'ALTER TABLE tactus.site ENABLE ROW LEVEL SECURITY';
    EXECUTE 'CREATE POLICY own_site ON tactus.site FOR SELECT TO tactus_uploader USING (role = current_user)';
    EXECUTE 'CREATE POLICY every_site ON tactus.site FOR SELECT TO tactus_reader USING (true)';
    FOREACH named IN ARRAY ARRAY['session', 'part', 'event', 'alarm', 'quantity'] LOOP
        EXECUTE format('ALTER TABLE tactus.%I ENABLE ROW LEVEL SECURITY', named);
        EXECUTE format('CREATE POLICY own_rows ON tactus.%I FOR SELECT TO tactus_uploader '
            'USING (site IN (SELECT name FROM tactus.site WHERE role = current_user))', named);
        EXECUTE format('CREATE POLICY own_additions ON tactus.%I FOR INSERT TO tactus_uploader '
            'WITH CHECK (site IN (SELECT name FROM tactus.site WHERE role = current_user))', named);
        EXECUTE format('CREATE POLICY every_row ON tactus.%I FOR SELECT TO tactus_reader USING (true)', named);
    END LOOP;
END
$$;
