import sys,numpy as np
from pathlib import Path
from tfg_drake.hardware.recordings import load_dataset
from tfg_drake.datasets.relations import read_relations
from tfg_drake.geometry import se2
name=sys.argv[1]
D=Path("/work/shared/data/radish")
log=load_dataset(D/f"{name}.clf.bz2"); rel=read_relations(D/f"{name}.relations.gz")
z=np.load(f"/tmp/log_{name}.npz"); X=se2.compose(z["X"],log.X_BS); at=z["at"]
from tfg_drake.datasets import relations as R
told=log.told_stamps
print([f for f in rel.__dataclass_fields__] if hasattr(rel,"__dataclass_fields__") else rel._fields, told.shape)
t=rel.times
i=np.clip(np.searchsorted(at,t),1,len(at)-1); sh=np.clip((t-at[i-1])/(at[i]-at[i-1]),0,1)
st=X[i]-X[i-1]; st[...,2]=se2.wrap_angle(st[...,2]); P=X[i-1]+sh[...,None]*st
A,B=P[:,0],P[:,1]
e=se2.between(se2.between(A,B),rel.X_12); tr=np.hypot(e[:,0],e[:,1]); ro=np.degrees(np.abs(se2.wrap_angle(e[:,2])))
print("median",np.median(tr),np.median(ro),"share>.25",(tr>.25).mean(), "mean of rest", tr[tr<.25].mean())
bad=np.flatnonzero(tr>.25); t0=at[0]
for k in bad[:: max(1,len(bad)//25)]: print(f"{t[k,0]-t0:.0f} {t[k,1]-t0:.0f} {tr[k]:.2f} {ro[k]:.1f}")
