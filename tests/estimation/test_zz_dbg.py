import numpy as np, pytest, time, os
from block_cases import fired, make_case
from sensing_cases import coarse_suite
from cpid_drake.estimation import online as O, fit as FI
import cpid_drake.estimation.following as W
from cpid_drake.estimation.online import run
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.logs.simulated_noise import add_noise
SUITE = coarse_suite(); MOMENTUM = np.array([3.0, -2.0, 4.0, 1.0, 0.5, -1.0])
@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, None, 14.0)
def test_q(case, capsys):
    capsys.disabled().__enter__()
    model = Model(case.craft.tree, SUITE); rng=np.random.default_rng(7)
    draws=[(float(10**rng.uniform(-4,0.3)),float(rng.uniform(5.2,13.5)),int(rng.integers(1e6))) for _ in range(24)]
    f=W._fitted
    def fitted(b,log,known,acting=(),**kw):
        if len(log.blocks)==1: return f(b,log,known,acting,**kw)
        o=FI._Step.taken
        def parts(r):
            for l,ro in zip(r.logs,r.rolled):
                inside=[{n:'%.3g'%np.sum(e**2) for n,e in l.rows_of(k,x).items()} for k,x in enumerate(ro.residuals)]
                print('     cost %.4g'%r.cost,'start %.3g joints %.3g links'%(ro.start,ro.joints),['%.3g'%l.link_cost(r.model,k,u) for k,u in enumerate(ro.links)],inside,'misfit %.3g'%r.misfit)
        def taken(self,now,share):
            r=o(self,now,share)
            print('   share',share,'square %.3g'%self.square, 'before %.4g least %.4g'%(self.before,self.least)); r and parts(r); return r
        FI._Step.taken=taken
        r=f(b,log,known,acting,**kw); FI._Step.taken=o
        print('    fit',len(log.blocks),sorted(log.open),list(acting),r.sweeps,r.converged,'%.4g'%r.cost); return r
    W._fitted=fitted
    for k in map(int,os.environ['K'].split(',')):
        size,when,seed=draws[k]; print(size,when)
        run(model, [add_noise(SUITE, fired(case, when, size * MOMENTUM), seed)])
