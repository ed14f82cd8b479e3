% Works of EIDORS for compare.py, which writes the file that the environment variable EIDORS_CASE names. Each line of standard input
% is a work; its answer is a line with the shortest processor time of a call, s, for 'memory' the bytes that the works took, or - where there is none.
1;

function bytes = most_memory()
    found = regexp(fileread('/proc/self/status'), 'VmHWM:\s*(\d+) kB', 'tokens');
    bytes = 1024 * str2double(found{1}{1});
end

function fmdl = model(given)
    fmdl = struct('type', 'fwd_model', 'name', 'disc', 'nodes', given.nodes, 'elems', double(given.elems), 'gnd_node', 1);
    fmdl.boundary = find_boundary(fmdl.elems);
    for e = 1:numel(given.contact)
        fmdl.electrode(e) = struct('nodes', double(given.electrodes{e}(:)'), 'z_contact', given.contact(e));
    end
    [pairs, ~, of] = unique(given.inject, 'rows');
    count = numel(given.contact);
    for k = 1:size(pairs, 1)
        sensed = given.measure(of == k, :);
        rows = (1:size(sensed, 1))';
        fmdl.stimulation(k).stimulation = 'Amp';
        fmdl.stimulation(k).stim_pattern = sparse(pairs(k, :), 1, [1 -1], count, 1);
        fmdl.stimulation(k).meas_pattern = sparse([rows; rows], sensed(:), [ones(size(rows)); -ones(size(rows))], rows(end), count);
    end
    fmdl.solve = @fwd_solve_1st_order;
    fmdl.jacobian = @jacobian_adjoint;
    fmdl.system_mat = @system_mat_1st_order;
    fmdl.normalize_measurements = 0;
end

function imdl = one_step(fmdl, conductance)
    imdl = eidors_obj('inv_model', 'one-step', 'fwd_model', fmdl, 'solve', @inv_solve_diff_GN_one_step, 'reconst_type', 'difference');
    imdl.hyperparameter.value = 0.03;
    imdl.RtR_prior = @prior_noser;
    imdl.prior_noser.exponent = 0.5;
    imdl.jacobian_bkgnd.value = conductance;
end

warning('off', 'all');
here = pwd;
evalc("run(fullfile(getenv('EIDORS_PATH'), 'startup.m'))");
cd(here);
eidors_msg('log_level', 0);
given = load(getenv('EIDORS_CASE'));
fmdl = model(given);
img = mk_image(fmdl, given.conductance);
before = most_memory();
while true
    work = input('', 's'); % fgetl would wait for more than a line
    if strcmp(work, 'memory')
        printf('%d\n', most_memory() - before);
        fflush(stdout);
        continue
    end
    if strcmp(work, 'frame')
        printf('-\n'); % in Octave its cache keeps no matrix: each call is a set-up
        fflush(stdout);
        continue
    end
    times = [];
    while numel(times) < 10 && sum(times) < 0.1
        eidors_cache('clear_all'); % it keeps what it has computed
        begin = cputime();
        switch work
            case 'forward'
                fwd_solve(img);
            case 'jacobian'
                calc_jacobian(img);
            case 'set-up'
                inv_solve(one_step(fmdl, given.conductance), given.baseline(:), given.frame(:));
        end
        times(end + 1) = cputime() - begin;
    end
    printf('%.9g\n', min(times));
    fflush(stdout);
end
