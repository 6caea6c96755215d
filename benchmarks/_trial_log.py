import sys, time, math, numpy as np, logging
from pathlib import Path
from tfg_drake.hardware.recordings import load_dataset
from tfg_drake.datasets.relations import read_relations, relation_errors
from tfg_drake.datasets.way import poses_between
from tfg_drake.geometry import se2
from tfg_drake.slam import estimator
from tfg_drake.slam.estimator_state import initial_state
from tfg_drake.slam.shared import SCANNER_X, SCANNER_Y
name, piece = sys.argv[1], float(sys.argv[2]); most=float(sys.argv[3]) if len(sys.argv)>3 else 1e18
D=Path("/work/shared/data/radish")
log=load_dataset(D/f"{name}.clf.bz2"); rel=read_relations(D/f"{name}.relations.gz")
print(name, len(log.odometry), len(log.scans), log.model, flush=True)
from tfg_drake.diagrams.recorded_station import RecordedScenario
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.slam.shared import by_data_sheet
from tfg_drake.slam.walls import no_walls
sc=RecordedScenario(log,Scenario())
U=float(__import__("os").environ.get("UNEVEN",sc.scan.unevenness))
state=initial_state(log.model, math.inf, by_data_sheet(sc.odometry,sc.tags,sc.scan), "dissection","walls",no_walls(U,sc.scan.least_looks))
from tfg_drake.slam import loop_search as ls
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.surfaces import Ties, no_ties
from tfg_drake.slam.localizer import start_localizer
from tfg_drake.messages import replace
import os
LOOPS=0; SEARCH=[ls.LoopSearch()]; NL=[0]; TS=[0.]

def close_loops(state):
    t=time.process_time()
    g=replace(state.graph,p_ML=state.map.p_ML)
    C=state.map.covariance; m=2*len(state.map.local) if hasattr(state.map,"local") else len(C)-19+0
    sig=np.array([math.sqrt(C[-3,-3]+C[-2,-2]),math.sqrt(C[-1,-1])])
    SEARCH[0],new=ls.searched(SEARCH[0],g,sig)
    TS[0]+=time.process_time()-t
    if not new: return state
    known={(l.old,l.newest) for l in SEARCH[0].closed}
    new=tuple(l for l in new if (l.old,l.newest) not in known)
    before=g.X_MN[-1].copy()
    far=[ls.still_open(g,l) for l in new]
    if any(far):
        g=ls.bent(g,SEARCH[0].closed,new)
        for _ in range(2): g,est=solve(g,state.map.stamp,state.map.observation)
        opened=[ls.still_open(g,l) for l in new]
        print(f"  loop {new[-1].old}-{new[-1].newest} n {len(new)} off {new[-1].off:.2f} rival {new[-1].rival:.2f} moved {np.hypot(*(g.X_MN[-1]-before)[:2]):.2f} open {opened}",flush=True)
        if any(opened):
            SEARCH[0]=replace(SEARCH[0],candidates=()); return state
    NL[0]+=1
    SEARCH[0]=replace(SEARCH[0],closed=(*SEARCH[0].closed,*new),tied=new[-1].newest)
    if not any(far): return state
    return replace(state,graph=g,solved=g,map=est,published=est.of_tags,localizer=start_localizer(est,state.walls))
import cProfile,pstats
PR=cProfile.Profile()
if os.environ.get('PROF'): PR.enable()
scans=iter(log.scans); scan=next(scans,None); last=None; length=0.; n=0; stamps=[]; t0=time.process_time(); pieces=0; begin=None
for odo in log.odometry:
    while scan is not None and scan.stamp<=odo.stamp:
        state=estimator.process_scan(state,scan); scan=next(scans,None); n+=1
    state=estimator.process_odometry(state,odo)
    if last is not None: length+=float(np.hypot(*(odo.X_OB-last.X_OB)[:2]))
    last=odo
    if begin is None: begin=odo.stamp
    if length>=piece and n>=2:
        b=state.piece.begin.stamp
        s2=estimator.close_piece(state,odo.stamp)
        if s2.map is not None and s2.map.stage>len(stamps): stamps.append(b)
        state=s2; length,n=0.,0; pieces+=1
        if LOOPS and state.map is not None: state=close_loops(state)
        if pieces%200==0: print(pieces, f"{time.process_time()-t0:.0f} s", len(state.graph.keyframes), len(state.graph.ids), state.map.X_MD.round(2), flush=True)
        if odo.stamp-log.odometry[0].stamp>most: break
PR.disable()
if os.environ.get('PROF'): pstats.Stats(PR).sort_stats('tottime').print_stats(32); pstats.Stats(PR).sort_stats('cumtime').print_stats(50)
b=state.piece.begin.stamp
t1=time.process_time()
def errors(state,lab):
    X=state.map.X_MA; st=np.array(stamps[:len(X)])
    at=np.array([s.stamp for s in log.scans]); ok=at<=st[-1]
    X_MB=poses_between(log,st,X); X_BS=log.X_BS
    e=relation_errors(at,se2.compose(X_MB,X_BS),rel,log.told_stamps)
    print(lab, e, flush=True)
    return X_MB
X1=errors(state,"online map")
state=estimator.finished_map(state)
t2=time.process_time()
X2=errors(state,"final")
print("loops",NL,TS,"CPU", t1-t0, t2-t1, len(state.graph.keyframes), sum(len(k.points) for k in state.graph.keyframes) if hasattr(state.graph.keyframes[0],"points") else 0)
np.savez(f"/tmp/log_{name}.npz", X=X2, at=np.array([s.stamp for s in log.scans]))
import pickle; pickle.dump((state, stamps), open(f"/tmp/log_{name}_{os.environ.get(chr(84)+chr(65)+chr(71),chr(120))}.pkl","wb"))
