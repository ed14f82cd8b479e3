-- Quantities as a hypertable of TimescaleDB, partitioned by week. It wants the time in every unique index; a line of a session has one time,
-- so the key means the same. Where TimescaleDB refuses, the table stays as it is. Returns nothing without the extension.
CREATE FUNCTION pg_temp.use_timescaledb() RETURNS text LANGUAGE plpgsql AS $function$
DECLARE
    home name;
    used boolean;
BEGIN
    SELECT n.nspname INTO home
    FROM pg_extension AS e JOIN pg_namespace AS n ON n.oid = e.extnamespace WHERE e.extname = 'timescaledb';
    IF home IS NULL THEN
        RETURN NULL;
    END IF;
    BEGIN
        EXECUTE 'SELECT EXISTS (SELECT FROM timescaledb_information.hypertables
            WHERE hypertable_schema = ''tactus'' AND hypertable_name = ''quantity'')' INTO used;
        IF used THEN
            RETURN 'used';
        END IF;
        ALTER TABLE tactus.quantity DROP CONSTRAINT quantity_pkey;
        ALTER TABLE tactus.quantity ADD PRIMARY KEY (site, daq, session, line, begin);
        EXECUTE format('SELECT %I.create_hypertable(''tactus.quantity''::regclass, ''begin''::name, '
            'chunk_time_interval => interval ''7 days'', migrate_data => true)', home);
        RETURN 'used';
    EXCEPTION WHEN OTHERS THEN
        -- also the change of the key is undone
        RETURN 'refused: ' || SQLERRM;
    END;
END
$function$;
